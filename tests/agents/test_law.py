"""The law: equations (6) and (7) at one node, and the same bits in every layout over processes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.topologies.errors import Code
from hedgerow.topologies.network import padded
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples
from tests.tools.networks import floats, gathered, listed, networks, partitions, read, simulate
from tests.tools.refusals import refusal

B = 0.1
MODELS = st.lists(st.lists(floats(0.03, 0.97), min_size=1, max_size=5), min_size=1, max_size=4)


class History(NamedTuple):
    """T samples of k nodes, with NaN flows where a message was lost: x (T + 1, k), flow (T, k)."""

    candidates: list[list[float]]
    x: Array
    flow: Array


@st.composite
def histories(draw: st.DrawFn, number: st.SearchStrategy[float] | None = None) -> History:
    number = floats(-8, 8) if number is None else number
    candidates = draw(MODELS)
    k, steps = len(candidates), draw(st.integers(1, 15))
    size = steps * k
    x = draw(st.lists(number, min_size=size + k, max_size=size + k))
    flow = draw(st.lists(number | st.just(np.nan), min_size=size, max_size=size))
    return History(candidates, np.array(x).reshape(steps + 1, k), np.array(flow).reshape(steps, k))


def taught(history: History) -> Minimax:
    """The law after all samples of a history."""
    law = Minimax(B, padded(history.candidates))
    for x, flow, x_next in zip(history.x[:-1], history.flow, history.x[1:], strict=True):
        law.learn(x, flow, x_next)
    return law


@given(histories())
def test_j_is_the_sum_of_7_over_the_whole_history(history: History) -> None:
    """J_i,m = sum_tau (a_m x_i + b f_i - x_i(tau+1))^2, at every node, without the samples lost."""
    law = taught(history)
    x, flow, x_next = history.x[:-1], history.flow, history.x[1:]
    for i, models in enumerate(history.candidates):
        received = ~np.isnan(flow[:, i])
        batch = [sum((a * x[received, i] + B * flow[received, i] - x_next[received, i]) ** 2) for a in models]
        np.testing.assert_allclose(law.J[: len(models), i], batch, rtol=1e-9, atol=1e-12)
        assert np.isinf(law.J[len(models) :, i]).all(), "what is no candidate never wins"


@given(histories())
def test_the_estimate_is_a_first_minimiser_from_the_nodes_own_list(history: History) -> None:
    law = taught(history)
    report = law.report()
    for i, models in enumerate(history.candidates):
        j = law.J[: len(models), i].tolist()
        index = j.index(min(j))
        least = sorted(j)
        margin = least[1] - least[0] if len(j) > 1 else np.inf
        assert report[:, i].tolist() == [models[index], margin]


@given(histories())
def test_the_estimate_is_the_candidate_nearest_least_squares(history: History) -> None:
    """Completing the square: J_m = J_LS + Sxx (a_m - a_LS)^2, unless a tie hides it."""
    law = taught(history)
    known = np.where(np.isnan(history.flow), 0.0, 1.0)
    sxx = (known * history.x[:-1] ** 2).sum(axis=0)
    y = history.x[1:] - law.b * np.nan_to_num(history.flow)
    sxy = (known * history.x[:-1] * y).sum(axis=0)
    for i, (ahat, margin) in enumerate(law.report().T):
        a_ls = sxy[i] / sxx[i] if sxx[i] else np.nan
        if sxx[i] == 0:
            assert ahat == history.candidates[i][0], "no sample: the first candidate"
        elif margin > 1e-9 * (1 + law.J[: len(history.candidates[i]), i].max()):
            distance = [abs(a - a_ls) for a in history.candidates[i]]
            assert abs(ahat - a_ls) <= min(distance) + 1e-9


@given(st.permutations([0.25, 0.5, 0.75]), st.sampled_from([0.375, 0.625]), st.integers(1, 8))
def test_a_tie_goes_to_the_first_in_list_order(models: list[float], halfway: float, samples: int) -> None:
    """The numbers are dyadic, so J ties exactly: a_LS is halfway between two candidates."""
    law = Minimax(0.5, padded([models]))
    assert law.ahat == [models[0]], "before any sample all tie at J = 0"
    for _ in range(samples):
        law.learn(np.array([1.0]), np.array([0.25]), np.array([halfway + 0.125]))
    tied = [a for a in models if abs(a - halfway) == 0.125]
    assert len(tied) == 2
    assert law.report()[:, 0].tolist() == [tied[0], 0.0]


@given(histories(), st.data())
def test_a_lost_sample_is_lost_to_its_node_alone(history: History, data: st.DataObject) -> None:
    """With a NaN flow at one node, its J stays unchanged, bit for bit; the other nodes learn."""
    assume(len(history.candidates) > 1)
    k = len(history.candidates)
    lost = data.draw(st.integers(0, k - 1))
    law, other = taught(history), taught(history)
    before = law.J[:, lost].copy(), law.report()[:, lost].copy()
    x, x_next = np.linspace(1, 2, k), np.linspace(2, -1, k)
    flow = np.ones(k)
    other.learn(x, flow, x_next)
    flow[lost] = np.nan
    law.learn(x, flow, x_next)
    assert law.J[:, lost].tobytes() == before[0].tobytes()
    assert law.report()[:, lost].tobytes() == before[1].tobytes()
    rest = np.arange(k) != lost
    assert law.J[:, rest].tobytes() == other.J[:, rest].tobytes()
    assert law.report()[:, rest].tobytes() == other.report()[:, rest].tobytes()
    assert (law.J[:, rest] != taught(history).J[:, rest])[np.isfinite(law.J[:, rest])].any()


@given(histories())
def test_rows_never_mix(history: History) -> None:
    """A node has the same results, bit for bit, alone and beside nodes with longer or shorter lists."""
    together = taught(history)
    for i, models in enumerate(history.candidates):
        own = History([models], history.x[:, [i]], history.flow[:, [i]])
        alone = taught(own)
        assert alone.J[:, 0].tobytes() == together.J[: len(models), i].tobytes()
        assert alone.report()[:, 0].tobytes() == together.report()[:, i].tobytes()


@given(histories())
def test_the_input_is_equation_6(history: History) -> None:
    """u = b x / (ahat - 1): it always opposes the state."""
    law = taught(history)
    x = history.x[-1]
    u = law.act(x)
    np.testing.assert_allclose(u * (law.ahat - 1), B * x, rtol=1e-15)
    assert (np.sign(u) == -np.sign(x)).all()


@pytest.mark.parametrize("law", ["hinf", "nominal"])
@given(topology=networks())
@settings(max_examples=25)
def test_the_fixed_laws_are_minimax_with_one_candidate(law: str, topology: Topology) -> None:
    """hinf knows each node's truth, nominal believes its nominal value: equation (8)."""
    fixed = topology.model_copy(update={"law": law})
    model = np.array([own.a if law == "hinf" else own.nominal for own in topology.nodes.values()])
    assert [view.law for view in views_of(fixed, layout(fixed, None))] == ["minimax"] * len(model)
    ran = simulate(fixed)
    assert (ran.u == topology.network.b * ran.x[:-1] / (model - 1)).all()
    assert (ran.report[:, 0] == model).all()
    one = {
        node: own.model_copy(update={"candidates": (float(a),)})
        for (node, own), a in zip(topology.nodes.items(), model, strict=True)
    }
    assert simulate(topology.model_copy(update={"nodes": one})).same_bits(ran)


@given(networks(most=7, steps=15), st.data())
@settings(max_examples=examples(60))
def test_every_layout_over_processes_gives_the_same_bits(topology: Topology, data: st.DataObject) -> None:
    """One shard of all nodes, one a node, any partition between: telemetry is equal."""
    n = len(topology.ids)
    one_a_node = simulate(topology)
    assert simulate(topology, layout(topology, 1)).same_bits(one_a_node)
    assert simulate(topology, data.draw(partitions(n))).same_bits(one_a_node)


@given(networks(), st.data())
@settings(max_examples=examples(40))
def test_an_agent_receives_only_its_nodes_and_neighbours(topology: Topology, data: st.DataObject) -> None:
    """Its view contains no truth, no x(0), no disturbance, and no edge of other nodes."""
    shards = data.draw(partitions(len(topology.ids)))
    views = views_of(topology, shards)
    assert [nodes.tolist() for nodes in truth_of(topology, shards).shards] == shards
    for view, nodes in zip(views, shards, strict=True):
        document = json.loads(view.to_json())
        assert set(document) == {"shard", "b", "law", "nodes", "peers", "history"}
        weights = topology.graph.weights
        weighed = set() if weights is None else {"weights"}
        assert [set(node) for node in document["nodes"]] == [{"id", "candidates", "neighbours"} | weighed] * len(nodes)
        gains = np.full(len(topology.ids), topology.network.b)[nodes]
        assert np.array_equal(np.broadcast_to(document["b"], len(nodes)), gains)
        for node in document["nodes"] if weights is not None else ():
            assert weights is not None
            beside_node = [k for k, edge in enumerate(topology.pairs) if node["id"] in edge]
            assert sorted(node.get("weights", [])) == sorted(weights[beside_node].tolist())
        own = {topology.ids[k] for k in nodes}
        beside = {end for edge in topology.pairs if own & set(edge) for end in edge} - own
        assert {node for peer in document["peers"] for node in peer["receives"]} == {*view.outside.tolist()} == beside
        assert all(
            {*node["neighbours"]} == {e for edge in topology.pairs if node["id"] in edge for e in edge} - {node["id"]}
            for node in document["nodes"]
        )
        assert [node["candidates"] for node in document["nodes"]] == [listed(topology)[k] for k in nodes]


@given(topology=networks(), data=st.data())
@settings(max_examples=examples(30))
def test_the_data_of_a_process_survive_its_file(
    topology: Topology, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The file is equal bit for bit, and contains only the view."""
    folder = tmp_path_factory.mktemp("views")
    shards = data.draw(partitions(len(topology.ids)))
    truth, views = truth_of(topology, shards), views_of(topology, shards)
    truth.write(folder / "plant.npz")
    for view in views:
        view.write(folder / f"{view.shard}.npz")
        with np.load(folder / f"{view.shard}.npz") as file:
            settings_of, arrays = json.loads(file["settings"].tobytes()), {*file.files} - {"settings"}
        assert settings_of.keys() - {"b", "seed"} == {"shard", "law", "history", "nodes", "peers", "ids"}
        lists = {"nodes.candidates", "nodes.neighbours", "nodes.weights", "peers.sends", "peers.receives"}
        own = {"nodes.id", "peers.shard", *(f"{name}.{part}" for name in lists for part in ("values", "sizes"))}
        assert own - {"nodes.weights.values", "nodes.weights.sizes"} <= arrays - {"b"} <= own
        assert ("b" in settings_of) != ("b" in arrays)
    back = [View.read(folder / f"{view.shard}.npz") for view in views]
    assert [view.to_json() for view in back] == [view.to_json() for view in views]
    again = gathered(reference.run(Truth.read(folder / "plant.npz"), back))
    assert again.same_bits(gathered(reference.run(truth, views)))


def test_ids_of_both_kinds_go_through_a_file(tmp_path: Path) -> None:
    """Names, integers beyond 64 bits, and a name of digits that no integer is written as."""
    topology = read("{name: n, b: 0.1, steps: 1, nodes: [dam, 9223372036854775808, '09223372036854775808']}")
    (view,) = views_of(topology, layout(topology, 1))
    view.write(tmp_path / "v.npz")
    assert View.read(tmp_path / "v.npz").ids.tolist() == ["dam", 9223372036854775808, "09223372036854775808"]


def test_sent_and_received_messages_are_equal() -> None:
    """Two shards of a ring: both list the boundary nodes of a link message in one order."""
    topology = read(
        "{name: ring, b: 0.1, steps: 1, nodes: [f, e, d, c, b, a],"
        " edges: [[a, b], [c, b], [c, d], [d, e], [f, e], [f, a]]}"
    )
    views = views_of(topology, [[0, 2, 4], [1, 3, 5]])
    (to_second,), (to_first,) = (view.peers for view in views)
    first, second = views
    assert first.ids[to_second.sends].tolist() == second.outside.tolist() == ["f", "d", "b"]
    assert second.ids[to_first.sends].tolist() == first.outside.tolist() == ["e", "c", "a"]
    assert to_second.receives == to_first.receives == 3


def test_candidates_of_different_lengths_run_together() -> None:
    """Lists of one, three and five candidates, in one shard: each node uses its own."""
    topology = read(
        "{name: n, b: 0.1, steps: 20, defaults: {x0: 4}, edges: [[1, 2], [2, 3]], nodes: {"
        "1: {candidates: [0.5]}, 2: {candidates: [0.2, 0.5, 0.8], a: 0.8},"
        "3: {candidates: [0.9, 0.1, 0.3, 0.5, 0.7], a: 0.7}}}"
    )
    ran = simulate(topology, layout(topology, 1))
    assert ran.report[-1, 0].tolist() == [0.5, 0.8, 0.7], "without noise all are found"
    assert ran.report[0, 0].tolist() == [0.5, 0.2, 0.9], "at t = 0 the first of each list"
    own = listed(topology)
    assert all(ahat in own[i] for row in ran.report for i, ahat in enumerate(row[0]))


@pytest.mark.parametrize(
    "law",
    [
        "nowhere.at_all:Law",
        "hedgerow.agents.law:Missing",
        "hedgerow.agents.law:np",  # without the methods of a law
    ],
)
def test_a_law_that_does_not_exist_is_refused(law: str) -> None:
    topology = read(f"{{name: n, b: 0.1, steps: 1, law: '{law}', nodes: [1]}}")
    with refusal(Code.LAW, f"law {law}"):
        simulate(topology)
