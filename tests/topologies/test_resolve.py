"""Drawing: the random values of a file, and their numbers in the resolved file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.verdict import Ending, judge
from hedgerow.topologies.disturbances import Constant
from hedgerow.topologies.hinf import satisfies_condition
from hedgerow.topologies.load import bundled, load, parse
from hedgerow.topologies.resolve import resolve, to_yaml, truth
from hedgerow.topologies.schema import LAWS, Topology
from tests.tools.examples import examples
from tests.tools.networks import floats, networks, observe, read, simulate

CHANCE = """\
name: chance
b: 0.15
steps: 5
seed: 11
defaults:
  x0: {random: [-3, 3]}
  candidates: {random: 4}
  a: random
  disturbance:
    - {kind: sinusoid, amplitude: {random: [0, 1]}, omega: {random: [0, 3]}}
    - {kind: white, std: {random: [0, 2]}}
nodes: {a: {}, b: {}, c: {}, d: {}}
edges: [[a, b], [b, c], [b, d]]
"""


def again(topology: Topology) -> Topology:
    """Return the topology read back from the file of a run."""
    return parse(to_yaml(topology).encode(), "topology.yaml", Path())


@given(networks())
@settings(max_examples=examples(60))
def test_a_resolved_network_is_final(topology: Topology) -> None:
    """A second resolution changes nothing, and its file gives the same bits."""
    assert resolve(topology) == topology
    assert again(topology) == topology
    assert to_yaml(again(topology)) == to_yaml(topology)


@pytest.mark.parametrize("name", bundled())
def test_a_bundled_network_is_final_once_it_is_resolved(name: str) -> None:
    topology = resolve(load(name))
    assert resolve(topology) == topology == again(topology)
    assert simulate(again(topology)).same_bits(simulate(topology))


@given(st.floats(-1e100, 1e100), st.floats(0, 1e100))
def test_every_number_survives_the_file(x0: float, std: float) -> None:
    """Subnormals, -0.0, 1e-05 and 1e99 alike."""
    disturbance = {"kind": "white", "std": std}
    node = {"x0": x0, "disturbance": disturbance}
    text = json.dumps({"name": "n", "b": 0.1, "steps": 1, "nodes": {"1": node}})
    topology = read(text)
    kept = again(topology).nodes[1]
    assert isinstance(kept.x0, float)
    assert kept.x0.hex() == x0.hex()
    assert kept.disturbance == topology.nodes[1].disturbance


@given(floats(0.005, 0.2), st.integers(1, 50), st.integers(0, 2**63 - 1), st.booleans())
@settings(max_examples=examples(60))
def test_drawn_candidates_satisfy_condition_3_and_contain_the_truth(
    b: float, m: int, seed: int, given_truth: bool
) -> None:
    """A hub and its leaves have different intervals; a given truth replaces one candidate."""
    a = 0.5 if given_truth else "random"
    text = CHANCE.replace("0.15", repr(b)).replace("random: 4", f"random: {m}")
    topology = read(text, f"seed={seed}", f"defaults.a={a}")
    degrees = [1, 3, 1, 1]
    for own, degree in zip(topology.nodes.values(), degrees, strict=True):
        assert isinstance(own.candidates, tuple)
        assert len(own.candidates) == m
        assert all(satisfies_condition(value, b, degree) for value in own.candidates)
        assert own.a in own.candidates
        assert own.a == 0.5 or not given_truth


def test_only_another_seed_draws_other_numbers() -> None:
    one, same, other = read(CHANCE), read(CHANCE), read(CHANCE, "seed=12")
    assert one == same
    for node in one.ids:
        a, b = one.nodes[node], other.nodes[node]
        assert a.x0 != b.x0
        assert not {*(a.candidates or ())} & {*(b.candidates or ())}
        assert a.disturbance != b.disturbance


@pytest.mark.parametrize(
    "pin",
    [
        "nodes.b.x0=1",
        "nodes.b.a=0.5",
        "nodes.b.candidates=[0.5]",
        "nodes.b.candidates={random: 9}",
        "nodes.b.nominal=0.4",
        "nodes.b.disturbance=none",
        "nodes.b.disturbance={kind: constant, value: {random: [0, 1]}}",
        "nodes.b.x0={random: [5, 6]}",
    ],
)
def test_to_pin_one_nodes_number_changes_no_other_nodes(pin: str) -> None:
    """Only the fixed number differs: neither the other nodes' numbers nor this node's other ones."""
    drawn, pinned = read(CHANCE), read(CHANCE, pin)
    key = pin.partition("=")[0].split(".")[2]
    for node in drawn.ids:
        one, other = drawn.nodes[node].model_dump(), pinned.nodes[node].model_dump()
        changed = {field for field in one if one[field] != other[field]}
        if node != "b":
            assert not changed
        elif key == "candidates":
            assert "candidates" in changed
            assert changed <= {"candidates", "a"}
            if "random" in pin:
                assert other["candidates"][:4] == one["candidates"], "more candidates are drawn behind those of fewer"
        elif key == "a":
            assert "a" in changed
            assert changed <= {"a", "candidates"}
        else:
            assert changed == {key}


def test_a_node_added_at_the_end_changes_no_other_nodes() -> None:
    more = read(CHANCE.replace("d: {}", "d: {}, e: {}"))
    assert all(read(CHANCE).nodes[node] == more.nodes[node] for node in "abcd")


@given(networks(most=5), floats(0.1, 9))
@settings(max_examples=examples(50))
def test_the_worst_case_has_the_energy_asked_for(topology: Topology, energy: float) -> None:
    """It becomes one constant a node, with |w|^2 = energy, along Q's smallest eigenvector."""
    worst = resolve(Topology.model_validate(topology.model_dump() | {"disturbance": {"energy": energy}}))
    assert worst.disturbance is None
    parts = [own.disturbance for own in worst.nodes.values()]
    w = np.array([part.value if isinstance(part, Constant) else 0.0 for part in parts])
    assert w @ w == pytest.approx(energy, rel=1e-12)
    observer = Observer(worst)
    s, b = 1 - truth(worst), worst.network.b
    laplacian = np.diag(worst.graph.weighted_degree.astype(float))
    laplacian[worst.graph.node, worst.graph.neighbour] -= 1 if worst.graph.weight is None else worst.graph.weight
    q_w = s * s * w + b * (laplacian @ (b * w))
    np.testing.assert_allclose(q_w, w / observer.gamma_star**2, rtol=1e-9, atol=1e-12)


def test_the_worst_case_costs_the_optimal_controller_gamma_star() -> None:
    """From rest, hinf's gain climbs to gamma* and never passes it; a milder w costs less."""
    text = (
        "{name: n, b: 0.2, steps: 4000, law: hinf, defaults: {candidates: [0.4, 0.6, 0.7]},"
        " nodes: {1: {a: 0.7}, 2: {a: 0.4}, 3: {a: 0.6}}, edges: [[1, 2], [2, 3]],"
    )
    observer, batch = observe(worst := read(text + "disturbance: worst_case}"), simulate(worst))
    gain = batch.gain()
    assert (np.diff(gain) > -1e-12).all()
    assert observer.gamma_star * (1 - 1e-3) < gain[-1] <= observer.gamma_star
    milder = read(text + "}", "defaults.disturbance={kind: constant, value: 0.5}")
    observer, batch = observe(milder, simulate(milder))
    assert batch.gain()[-1] < 0.99 * observer.gamma_star


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", bundled())
def test_every_bundled_network_runs_and_is_valid_under_every_law(name: str, law: str) -> None:
    topology = resolve(load(name, [f"law={law}"]))
    observer, batch = observe(topology, simulate(topology))
    verdict = judge(topology, observer, Ending("run", "in-process", 1))
    assert (verdict.verdict, verdict.exit_code) == ("valid", 0), verdict.content["reasons"]
    assert verdict.content["steps_done"] == topology.steps == len(batch.t)
    if law == "hinf":
        assert verdict.content["metrics"]["cost_regret"] == 0
        assert (batch.right == len(topology.ids)).all()
    if law == "nominal":
        assert batch.regret_sum.tolist() == batch.nominal_regret_sum.tolist()
