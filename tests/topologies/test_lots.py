"""Lots: a function of (seed, field, id, step) alone, with the right distribution, and the same bits on every
machine.
"""

from __future__ import annotations

import hashlib
import json
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats

from hedgerow.orchestrator.metrics.fault_schedule import Schedule
from hedgerow.plant.disturbance import Disturbance, noise_keys
from hedgerow.plant.faults import ActiveFaults, Faults
from hedgerow.topologies import lots
from hedgerow.topologies.faults import effects
from hedgerow.topologies.graph import Array
from hedgerow.topologies.load import load
from hedgerow.topologies.network import Group
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples

IDS = st.one_of(st.integers(-(2**63), 2**63 - 1), st.from_regex(r"[A-Za-z_][A-Za-z0-9_.-]{0,20}", fullmatch=True))
SEEDS = st.integers(0, 2**63 - 1)
FIELD = "disturbance.0.white"


def network(
    ids: list[int | str], edges: list[tuple[int | str, int | str]], seed: int, faults: list[dict[str, Any]]
) -> Topology:
    """Return a network with only random numbers."""
    chance = {
        "x0": {"random": [-1, 1]},
        "candidates": {"random": 3},
        "disturbance": [
            {"kind": "sinusoid", "amplitude": {"random": [0, 1]}, "omega": {"random": [0, 3]}, "phase": 0.5},
            {"kind": "white", "std": {"random": [0.1, 1]}},
        ],
    }
    given = {"name": "n", "b": 0.01, "steps": 12, "seed": seed, "nodes": ids, "edges": edges}
    return resolve(Topology.model_validate({**given, "defaults": chance, "faults": faults}))


def noise(topology: Topology, steps: int = 12) -> dict[int | str, bytes]:
    """The disturbances of each node."""
    source = Disturbance(topology.network.disturbance, topology.ids, topology.seed)
    w = np.array([source.at(t) for t in range(steps)])
    return {node: w[:, k].tobytes() for k, node in enumerate(topology.ids)}


def struck(topology: Topology) -> set[tuple[int, int, Any]]:
    """(fault, step, ids of the target) of all that the faults strike."""
    graph, ids, found = topology.graph, topology.ids, set()
    schedule = Schedule(topology)
    for thing in ("lost", "late", "cut", "blind", "mute"):
        for fault, t, k in zip(
            *(column.tolist() for column in schedule.instances(np.arange(topology.steps), thing)), strict=True
        ):
            if thing in ("lost", "late"):
                target: Any = (ids[graph.neighbour[k]], ids[graph.node[k]])
            elif thing == "cut":
                target = frozenset(ids[i] for i in graph.edges[k])
            else:
                target = ids[k]
            found.add((fault, t, target))
    return found


def tree(ids: list[int | str]) -> list[tuple[int | str, int | str]]:
    """Edges from each node to one before it."""
    return [(ids[(k - 1) // 2], ids[k]) for k in range(1, len(ids))]


def by_chance(ids: list[int | str]) -> list[dict[str, Any]]:
    """Return random faults of each kind, and a jump."""
    lot = {"probability": 0.5}
    return [
        {"kind": "drop", "link": [ids[0], ids[1]], **lot},
        {"kind": "delay", "from": ids[1], "to": ids[0], "by": 2, **lot},
        {"kind": "cut", "edge": [ids[0], ids[1]], **lot},
        {"kind": "sensor", "node": ids[1], **lot},
        {"kind": "actuator", "node": ids[0], **lot},
        {"kind": "drop", "link": [ids[1], ids[0]], **lot},
        {"kind": "jump", "node": ids[0], "at": 5, "a": "random"},
    ]


@given(st.lists(IDS, min_size=2, max_size=8, unique_by=str), SEEDS, st.randoms(use_true_random=False))
@settings(max_examples=examples(40), deadline=None)
def test_the_order_of_nodes_changes_no_lot(ids: list[int | str], seed: int, order: random.Random) -> None:
    edges, faults = tree(ids), by_chance(ids)
    mixed = list(ids)
    order.shuffle(mixed)
    one = network(ids, edges, seed, faults)
    other = network(mixed, [edge[::-1] for edge in edges[::-1]], seed, faults)
    assert {node: one.nodes[node] for node in ids} == {node: other.nodes[node] for node in ids}
    assert noise(one) == noise(other)
    assert struck(one) == struck(other)
    assert one.faults == other.faults


@given(st.lists(IDS, min_size=3, max_size=8, unique_by=str), SEEDS, st.data())
@settings(max_examples=examples(40), deadline=None)
def test_an_added_node_changes_no_other_lot(ids: list[int | str], seed: int, data: st.DataObject) -> None:
    """The new node changes the interval of condition (3) of its one neighbour; all other nodes keep everything."""
    *old, new = ids
    at, host = data.draw(st.integers(0, len(old))), data.draw(st.sampled_from(old))
    faults = by_chance(ids)[:-1]
    one = network(old, tree(old), seed, faults)
    added = {"kind": "sensor", "node": new, "probability": 0.5}
    other = network([*old[:at], new, *old[at:]], [(new, host), *tree(old)], seed, [*faults, added])
    for node in old:
        kept = {"candidates", "a"} if node == host else set()
        assert one.nodes[node].model_dump(exclude=kept) == other.nodes[node].model_dump(exclude=kept)
    w = noise(other)
    assert noise(one) == {node: w[node] for node in old}
    assert struck(one) == {hit for hit in struck(other) if hit[0] < len(faults)}


def test_a_fault_that_is_added_late_or_ends_early_has_the_lots_that_the_file_gives_it() -> None:
    """Otherwise a run with live faults could not be repeated from its recorded file."""
    ids: list[int | str] = ["a", "b", "c"]
    lot = {"kind": "sensor", "node": "b", "probability": 0.5}
    recorded = network(ids, tree(ids), 8, [{**lot, "steps": [0, 9]}, {**lot, "steps": [3, 12]}])
    first, second = effects(recorded.faults, recorded)
    live = Faults([replace(first, stop=12)], recorded.graph, ids, 8)
    file = Faults([first, second], recorded.graph, ids, 8)
    for t in range(12):
        if t == 3:
            live.add([second])
        if t == 9:
            live.end(0, 9)
        one, other = ((some.at(t) or ActiveFaults()).blind for some in (live, file))
        assert (one is None) == (other is None)
        assert one is None or other is None or (one == other).all()


def test_a_fault_elsewhere_changes_no_lot_and_two_at_one_target_are_independent() -> None:
    ids: list[int | str] = [1, 2, 3]
    lot = {"kind": "drop", "link": [1, 2], "probability": 0.5}
    far = {"kind": "drop", "link": [1, 3], "probability": 0.5}
    alone = struck(network(ids, tree(ids), 4, [lot]))
    beside = struck(network(ids, tree(ids), 4, [far, {**far, "probability": 1}, lot]))
    assert {hit[1:] for hit in alone} == {hit[1:] for hit in beside if hit[0] == 2}
    twice = struck(network(ids, tree(ids), 4, [lot, lot]))
    assert {hit[1:] for hit in twice if hit[0] == 0} == {hit[1:] for hit in alone}
    assert {hit[1:] for hit in twice if hit[0] == 1} != {hit[1:] for hit in alone}


@given(st.lists(IDS, min_size=1, max_size=6, unique_by=str), st.lists(SEEDS, min_size=1, max_size=5))
@settings(max_examples=examples(60))
def test_many_seeds_and_steps_at_once_are_one_by_one(ids: list[int | str], seeds: list[int]) -> None:
    words, steps = lots.words_of(ids), np.array([0, 1, 7, 2**40])
    keys = noise_keys("white", np.array(seeds, dtype=np.uint64)[:, None], 0, words)
    whole = lots.normals(lots.at(keys[..., None], steps))
    assert whole.shape == (len(seeds), len(ids), len(steps))
    for s, seed in enumerate(seeds):
        for k, node in enumerate(ids):
            key = lots.keys(seed, FIELD, lots.words_of([node]))
            for j, t in enumerate(steps.tolist()):
                assert lots.normals(lots.at(key, np.array([t])))[0] == whole[s, k, j]


@given(st.lists(st.integers(0, 400), min_size=1, max_size=30), st.sampled_from([1, 3, 700]))
@settings(max_examples=examples(30))
def test_white_noise_is_the_same_whichever_steps_were_asked_for_before(asked: list[int], n: int) -> None:
    group = Group(0, "white", np.arange(n), {"std": np.linspace(0.5, 2, n)})
    source = Disturbance([group], range(n), 5)
    for t in asked:
        assert source.at(t).tobytes() == Disturbance([group], range(n), 5).at(t).tobytes()


@given(IDS)
def test_a_whole_number_and_its_text_are_one_id(node: int | str) -> None:
    assert (lots.words_of([node]) == lots.words_of([str(node)])).all()
    assert (lots.words_of([node, "a"]) == lots.words_of(np.array([node, "a"], dtype=object))).all()


def test_other_texts_are_other_ids() -> None:
    ids: list[int | str] = [7, "007", "+7", "7.0", "7_", "-7", -7, 2**64 + 7, "a", "b", "ab", "ba", "aa", "é", "e", ""]
    words = lots.words_of(ids)
    assert len(np.unique(words)) == len(ids) - 1, "only -7 is there twice"
    assert (lots.words_of(range(5, 9)) == lots.words_of([5, 6, 7, 8])).all()
    assert (lots.words_of(np.arange(5, 9)) == lots.words_of(range(5, 9))).all()
    assert lots.words_of([]).shape == (0,)
    a, b = lots.words_of(["a"]), lots.words_of(["b"])
    assert lots.pairs_of(a, b) != lots.pairs_of(b, a)
    assert lots.edges_of(a, b) == lots.edges_of(b, a)


def test_the_same_bits_everywhere() -> None:
    """A digest of a million lots of each kind, and some of them in words: a machine that differs fails here."""
    assert lots.mix(np.array([0], dtype=np.uint64))[0] == 0xE220A8397B1DCDAF, "the first number of SplitMix64"
    words = lots.at(lots.keys(1, FIELD, lots.words_of(range(1000)))[:, None], np.arange(1000))
    uniforms, normals = lots.uniforms(words), lots.normals(words)
    digests = [hashlib.sha256(numbers.astype("<f8").tobytes()).hexdigest()[:16] for numbers in (uniforms, normals)]
    assert digests == DIGESTS
    ends = np.array([0, 2**63, 2**64 - 1, 2**30], dtype=np.uint64)
    assert [value.hex() for value in lots.normals(ends).tolist()] == ENDS


DIGESTS: list[str] = ["f620f9aa9e2bc7ab", "e62828b43bd00eed"]
ENDS: list[str] = ["-0x1.06b48528cea51p+3", "0x1.40d931ff62707p-52", "0x1.06b48528cea51p+3", "-0x1.9c696b259a2d9p+2"]


def test_normals_are_the_quantiles() -> None:
    """Against SciPy, over the whole range: down to 2^-53 and up to 1 - 2^-53."""
    words = np.concatenate(
        [
            np.random.default_rng(1).integers(0, 2**64, 10**5, dtype=np.uint64),
            np.uint64(1) << np.arange(12, 64, dtype=np.uint64),
            ~(np.uint64(1) << np.arange(12, 64, dtype=np.uint64)),
        ]
    )
    p = ((words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    np.testing.assert_allclose(lots.normals(words), special.ndtri(p), rtol=4e-15, atol=1e-15)
    assert (lots.normals(words) == -lots.normals(~words)).all()


SIZE = 500


@pytest.fixture(scope="module")
def cube() -> Array:
    """Lots in [0, 1) by seed, node and step, (20, 100, 500): seeds, nodes and steps that lie side by side."""
    keys = lots.keys(np.arange(20, dtype=np.uint64)[:, None], FIELD, lots.words_of(range(100)))
    return lots.uniforms(lots.at(keys[..., None], np.arange(SIZE)))


def test_uniforms_are_uniform(cube: Array) -> None:
    assert stats.kstest(cube.ravel(), "uniform").pvalue > 0.001
    for axis in range(3):
        each = np.moveaxis(cube, axis, 0).reshape(cube.shape[axis], -1)
        p = [stats.kstest(row, "uniform").pvalue for row in each]
        assert stats.kstest(p, "uniform").pvalue > 0.001
    words = (cube.ravel() * 2.0**53).astype(np.uint64)
    ones = ((words[:, None] >> np.arange(53, dtype=np.uint64)) & np.uint64(1)).mean(axis=0)
    assert (np.abs(ones - 0.5) < 5 * 0.5 / np.sqrt(len(words))).all(), "each bit is 0 as often as 1"


def test_normals_are_normal() -> None:
    keys = lots.keys(np.arange(20, dtype=np.uint64)[:, None], FIELD, lots.words_of(range(100)))
    z = lots.normals(lots.at(keys[..., None], np.arange(SIZE)))
    assert stats.kstest(z.ravel(), "norm").pvalue > 0.001
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((z**power).mean() - moment) < 5 * np.sqrt(variance / z.size)


@pytest.mark.parametrize("axis", range(3), ids=["seeds", "nodes", "steps"])
@pytest.mark.parametrize("apart", [1, 2, 8])
def test_neighbours_are_not_correlated(cube: Array, axis: int, apart: int) -> None:
    """This covers numbers, their squares, and low bits, for neighbouring seeds, nodes and steps."""
    centred = (cube - 0.5) * np.sqrt(12)
    low = (cube * 2.0**20) % 1 - 0.5
    for values in (centred, centred**2 - 1, low):
        moved = np.moveaxis(values, axis, 0)
        one, other = moved[:-apart].ravel(), moved[apart:].ravel()
        assert abs(np.corrcoef(one, other)[0, 1]) < 5 / np.sqrt(len(one))


def test_fields_links_and_edges_are_not_correlated() -> None:
    words = lots.words_of(range(200))
    one, other = words[:, None].repeat(200, 1).ravel(), words[None].repeat(200, 0).ravel()
    links = lots.pairs_of(one, other)
    drawn = [
        lots.uniforms(lots.at(lots.keys(3, field, links), np.array([4]))) for field in ("drop.0", "drop.1", "cut.0")
    ]
    back = lots.uniforms(lots.at(lots.keys(3, "drop.0", lots.pairs_of(other, one)), np.array([4])))
    apart = one != other
    sample = np.array([*drawn, back])[:, apart]
    correlation = np.corrcoef(sample)[np.triu_indices(4, 1)]
    assert (np.abs(correlation) < 5 / np.sqrt(sample.shape[1])).all()


def test_one_network_from_yaml_json_and_a_table_draws_the_same(tmp_path: Path) -> None:
    """With ids in another order, and quoted where the format quotes them."""
    common = "name: n\nb: 0.1\nsteps: 5\nseed: 9\ndefaults: {x0: {random: [0, 1]}}\n"
    (tmp_path / "a.yaml").write_text(common + "nodes: [1, 2, 30]\nedges: [[1, 2], [2, 30]]\n")
    nodes: dict[str, Any] = {"30": {}, "2": {}, "1": {}}
    defaults = {"x0": {"random": [0, 1]}}
    written = {"name": "n", "b": 0.1, "steps": 5, "seed": 9, "nodes": nodes, "edges": [[30, 2], [1, 2]]}
    (tmp_path / "b.json").write_text(json.dumps({**written, "defaults": defaults}))
    np.savez(tmp_path / "c.npz", ids=np.array([2, 30, 1]), edges=np.array([[0, 1], [2, 0]]))
    (tmp_path / "c.yaml").write_text(common + "table: c.npz\n")
    one, *others = (resolve(load(str(tmp_path / name)), tmp_path) for name in ("a.yaml", "b.json", "c.yaml"))
    for other in others:
        assert all(one.nodes[one.ids[k]] == other.nodes[one.ids[k]] for k in range(3))


def test_lots_in_a_file_hold_for_their_seed_alone() -> None:
    text: dict[str, Any] = {"name": "n", "b": 0.1, "steps": 2, "seed": 3, "nodes": [1, 2], "edges": [[1, 2]]}
    text["defaults"] = {"x0": {"random": [0, 10]}, "candidates": {"random": 3}}
    given = {"seed": 3, "nodes": {1: {"x0": 0.25, "candidates": [0.5]}, "gone": {"x0": 0.5}}}
    plain, pinned = (resolve(Topology.model_validate(text | more)) for more in ({}, {"lots": given}))
    assert pinned.nodes[1].x0 == 2.5
    assert pinned.nodes[1].candidates[1:] == plain.nodes[1].candidates[1:]  # type: ignore[index]
    assert pinned.nodes[1].candidates[0] == pytest.approx(0.5)  # type: ignore[index]
    assert pinned.nodes[2] == plain.nodes[2]
    assert pinned.lots is None
    assert resolve(pinned) == pinned
    other = {"seed": 4}
    assert resolve(Topology.model_validate(text | other)) == resolve(
        Topology.model_validate(text | other | {"lots": given})
    )


def test_the_network_of_the_paper_keeps_its_numbers() -> None:
    """gamma* as the theory page has it, and the truth to the bit."""
    drawn = resolve(load("paper7")).network
    assert round(drawn.gamma_star, 3) == 2.974
    assert hashlib.sha256(drawn.a.tobytes() + drawn.candidates.tobytes()).hexdigest()[:16] == PAPER7


PAPER7 = "e5b630727ec191a9"
