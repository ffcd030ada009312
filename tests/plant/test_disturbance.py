"""Disturbances that have a memory or see the state: coloured noise, and the one that confuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.experiments.sweep.runs import run_here
from hedgerow.orchestrator.metrics.replay import PLAN, Replay
from hedgerow.plant.disturbance import Disturbance
from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.graph import Array
from hedgerow.topologies.network import groups_of
from hedgerow.topologies.resolve import to_yaml
from hedgerow.topologies.schema import Topology
from tests.tools.networks import floats, partitions, read, simulate
from tests.tools.processes import orchestrator

AR1 = {"kind": "ar1", "phi": 0.9, "std": 2.0}


def noise(nodes: int, seed: int = 3) -> Disturbance:
    return Disturbance(groups_of([[AR1]] * nodes, 10), range(nodes), seed)


def network(disturbance: str, x0: float = 5, faults: str = "", steps: int = 30, seed: int = 3) -> Topology:
    return read(
        f"{{name: n, b: 0.1, steps: {steps}, seed: {seed}, graph: {{kind: random_tree, nodes: 5}},"
        f" defaults: {{x0: {x0}, candidates: {{random: 4}}, disturbance: {disturbance}}}, faults: [{faults}]}}"
    )


def test_coloured_noise_is_stationary_with_its_correlation() -> None:
    """4000 nodes: std at t = 0 and later, correlation phi^k over k steps, no correlation between nodes."""
    n = 4000
    source = noise(n)
    w = np.array([source.at(t) for t in range(40)]) / 2.0
    error = 1 / math.sqrt(n)
    assert (np.abs((w * w).mean(axis=1) - 1) < 8 * error).all()
    for k in (1, 5, 20):
        assert abs((w[0] * w[k]).mean() - 0.9**k) < 5 * error
    assert abs((w[0, 1:] * w[0, :-1]).mean()) < 5 * error


def test_coloured_noise_is_a_function_of_seed_node_and_step() -> None:
    """In any order of calls, and beside fewer nodes, it has the same bits; another seed gives other noise."""
    forwards = np.array([noise(4).at(t) for t in range(20)])
    source = noise(4)
    again = np.array([source.at(t) for t in reversed(range(20))])[::-1]
    assert forwards.tobytes() == again.tobytes()
    source = noise(2)
    assert all((source.at(t) == forwards[t, :2]).all() for t in range(20))
    assert not (noise(4, seed=4).at(5) == forwards[5]).any()


@given(candidate=floats(0.05, 0.95) | st.just("random"), seed=st.integers(0, 2**31), jumps=st.booleans())
@settings(max_examples=20)
def test_the_node_moves_as_if_the_candidate_were_the_truth(candidate: float | str, seed: int, jumps: bool) -> None:
    """w(t) = (a' - a_i(t)) x_i(t) to the bit, also after the truth jumped, and in another layout."""
    fault = "{kind: jump, node: 2, at: 12, a: random}" if jumps else ""
    topology = network(f"{{kind: confuse, candidate: {candidate}}}", seed=seed, faults=fault)
    ran = simulate(topology)
    (group,) = topology.network.disturbance
    drawn: Array = group.values["candidate"]
    a = topology.network.a.copy()
    for t, x, w in zip(range(30), ran.x, ran.w, strict=False):
        if jumps and t == 12:
            a[2] = topology.faults[0].a  # type: ignore[union-attr]
        assert w.tobytes() == ((drawn - a) * x).tobytes()
    if candidate == "random":
        assert all(a in node.candidates and a != node.a for a, node in zip(drawn, topology.nodes.values(), strict=True))  # type: ignore[operator]
    assert simulate(topology, [range(5)]).same_bits(ran)
    assert read(to_yaml(topology)).network.disturbance[0].values["candidate"].tobytes() == drawn.tobytes()


def test_there_is_no_confusion_at_rest() -> None:
    """From x(0) = 0 the state and the disturbance stay 0, and the gain is undefined."""
    topology = network("{kind: confuse, candidate: random}", x0=0)
    assert not simulate(topology).w.any()
    assert run_here(topology)["metrics"]["gain"] is None


def test_the_twins_get_the_recorded_w() -> None:
    """The oracle's twin meets the w of the run as a signal, so its certificate holds and the run is valid."""
    topology = network("{kind: confuse, candidate: random}")
    content = run_here(topology)
    assert content["verdict"] == "valid"
    assert content["checks"]["oracle_certificate"]["ok"]
    assert content["metrics"]["regret"] > 0


@given(data=st.data(), seed=st.integers(0, 2**31))
@settings(max_examples=10)
def test_every_layout_gives_the_same_bits_with_both_kinds(data: st.DataObject, seed: int) -> None:
    both = "[{kind: confuse, candidate: 0.7}, {kind: ar1, phi: -0.5, std: 0.2}]"
    topology = network(both, seed=seed, faults="{kind: drop, probability: 0.2, from: 1, to: 0}")
    if not any({1, 0} == set(pair) for pair in topology.pairs):
        return
    assert simulate(topology, data.draw(partitions(5))).same_bits(simulate(topology))


@pytest.mark.parametrize("audited", [2, 20_000])
def test_the_replay_finds_a_confusing_disturbance_that_is_not_the_files(audited: int) -> None:
    """Also where it replays some of the nodes, and after a jump."""
    topology = network("{kind: confuse, candidate: 0.7}", faults="{kind: jump, node: 2, at: 12, a: random}")
    rows = simulate(topology).rows
    replay = Replay(topology, audited)
    replay.take(rows)
    assert (replay.finding, replay.doubt, replay.steps) == (None, "", 30)
    wrong = rows[20]._replace(w=rows[20].w * (1 + 1e-15))
    replay = Replay(topology, audited)
    replay.take([*rows[:20], wrong])
    assert replay.finding is not None
    assert (replay.finding.check, replay.finding.step) == (PLAN, 20)


@pytest.mark.parametrize(
    "wrong", ["{kind: confuse, candidate: 1}", "{kind: confuse}", "{kind: ar1, phi: 1, std: 1}", "{kind: ar1, phi: 0}"]
)
def test_a_number_out_of_range_is_refused(wrong: str) -> None:
    with pytest.raises(TopologyError):
        network(wrong)


@pytest.mark.slow
def test_seven_processes_meet_the_same_disturbance_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    both = "defaults.disturbance=[{kind: confuse, candidate: random}, {kind: ar1, phi: 0.9, std: 0.3}]"
    drop = "faults=[{kind: drop, from: 2, to: 4, probability: 0.4}, {kind: jump, node: 5, at: 9, a: random}]"
    for law in ("notch", "thompson", "hysteresis(h=0.2)"):
        ran = orchestrator(
            *("up", "paper7", "--viewer=none", "--no-record", "--verify", f"--law={law}", f"--run-dir={law[:5]}"),
            *(f"--set={both}", f"--set={drop}"),
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
