"""Faults in one process: their effects on the plant and on the knowledge of nodes, and no others."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.agents.shard import Shard
from hedgerow.orchestrator.ground.assignment import candidates_of, layout, views_of
from hedgerow.topologies.hinf import contraction
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import Link, State
from tests.tools.networks import networks, partitions, read, simulate
from tests.tools.schedules import Plain, schedules, with_faults


@st.composite
def faulty(draw: st.DrawFn, most: int = 5, steps: int = 14) -> Topology:
    """Any network under any schedule, with back-filling or without."""
    topology = draw(networks(most=most, steps=steps))
    return with_faults(topology, draw(schedules(topology)), backfill=draw(st.sampled_from([True, True, False])))


@given(topology=faulty(), history=st.sampled_from([1, 2, 5, 100_000]), data=st.data())
def test_faults_mean_the_same_in_every_layout(topology: Topology, history: int, data: st.DataObject) -> None:
    topology = topology.model_copy(update={"history": history})
    assert simulate(topology, data.draw(partitions(len(topology.ids)))).same_bits(simulate(topology))


def harsh(seed: int) -> list[str]:
    """Random faults of paper7: agents die and return while messages on several links are lost or late."""
    lots = random.Random(seed)

    def steps(longest: int) -> str:
        start = lots.randrange(55)
        return f"steps: [{start}, {start + lots.randint(1, longest)}]"

    def link() -> str:
        return lots.choice(["[1, 2]", "[2, 3]", "[2, 4]", "[3, 5]", "[4, 6]", "[4, 7]"])

    def node() -> str:
        return f"node: {lots.randint(1, 7)}"

    kinds = {
        "crash": lambda: f"{node()}, at: {lots.randrange(5, 50)}, restart_after: {lots.randint(1, 12)}",
        "drop": lambda: f"link: {link()}, {steps(25)}",
        "delay": lambda: f"link: {link()}, by: {lots.randint(1, 4)}, {steps(15)}",
        "cut": lambda: f"edge: {link()}, {steps(15)}",
        "sensor": lambda: f"{node()}, {steps(6)}",
    }
    counts = {"crash": (1, 3), "drop": (1, 6), "delay": (0, 2), "cut": (0, 2), "sensor": (0, 2)}
    return [f"{{kind: {kind}, {kinds[kind]()}}}" for kind, some in counts.items() for _ in range(lots.randint(*some))]


@pytest.mark.parametrize("history", [10, 30, 100_000])
@pytest.mark.parametrize("seed", range(12))
def test_a_returning_node_changes_nothing_for_waiting_ones(seed: int, history: int) -> None:
    """In a process of several nodes, each is learned again from its own gap, and from rows that were meant for it."""
    topology = resolve(load("paper7", ["steps=60", f"history={history}", f"faults=[{', '.join(harsh(seed))}]"]))
    alone = simulate(topology, layout(topology, 7))
    assert all(simulate(topology, layout(topology, processes)).same_bits(alone) for processes in (1, 2, 3))


def test_rows_that_are_for_one_node_leave_those_of_another() -> None:
    """4 and 5 share a process. Its repeated rows for 4 have nothing for 5, and 3 has received those of 5 long ago."""
    crashes = [
        f"{{kind: crash, node: {node}, at: {at}, restart_after: {pause}}}"
        for node, at, pause in ((4, 31, 10), (5, 33, 9))
    ]
    drops = ["{kind: drop, link: [2, 3], steps: [35, 46]}", "{kind: drop, link: [2, 4], steps: [26, 39]}"]
    topology = resolve(load("paper7", ["steps=60", f"faults=[{', '.join(crashes + drops)}]"]))
    assert simulate(topology, layout(topology, 3)).same_bits(simulate(topology, layout(topology, 7)))


def test_additional_rows_of_a_neighbour_affect_only_its_own() -> None:
    """Every link message from node 1 also brings the row before: node 2 alone receives it, without harm."""
    view = views_of(resolve(load("paper7")), layout(resolve(load("paper7")), 7))[1]
    answer_of, misled = Shard(view), Shard(view)
    lots = np.random.default_rng(0)
    for t in range(100):
        state = State(t, lots.normal(size=1), b"")
        for shard in (answer_of, misled):
            shard.answer(state)
        rows = lots.normal(size=(len(view.peers), 2))
        for p, row in enumerate(rows):
            link = Link(t, t, row[1:].tobytes(), row[1:].tobytes())
            answer_of.receive(p, link)
            misled.receive(p, Link(t, t - 1, row.tobytes(), row.tobytes()) if p == 0 else link)
        np.testing.assert_array_equal(answer_of.report, misled.report)


@given(faulty())
def test_every_node_knows_the_rows_of_the_plain_rules(topology: Topology) -> None:
    """Estimates after every gap, late message, crash and restart are those of the same samples without the gap."""
    ran = simulate(topology)
    np.testing.assert_array_equal(ran.report[:, 0], Plain(topology, ran).ahat())


@given(faulty())
def test_the_contraction_holds_and_no_missing_input_flows(topology: Topology) -> None:
    ran, graph, models = simulate(topology), topology.graph, candidates_of(topology)
    # Before a jump and after it the truth is one of the candidates: the largest bounds them all.
    rho = contraction(np.nanmax(models, axis=0), models)
    b = topology.network.b
    for row, x_next in zip(ran.rows, ran.x[1:], strict=True):
        norm = np.sum(np.abs(row.x) / b)
        assert np.sum(np.abs(x_next) / b) <= rho * norm + np.sum(np.abs(row.w) / b) + 1e-9 * (1 + norm)
        missing = np.isnan(row.u)
        assert not row.edge_open[missing[graph.edges].any(axis=1)].any()


PAPER = """
name: long
b: 0.1
steps: 160
seed: 5
defaults: {x0: 15, disturbance: {kind: white, std: 0.3}}
nodes: [1, 2, 3, 4, 5, 6, 7]
edges: [[1, 2], [2, 3], [2, 4], [3, 5], [3, 6], [4, 7]]
"""
LOSSY = [{"kind": "drop", "link": [2, 3], "probability": 0.3}, {"kind": "drop", "link": [3, 6], "probability": 0.5}]


@pytest.mark.parametrize(
    "outage",
    [
        {"kind": "drop", "link": [3, 5], "steps": [20, 140]},
        {"kind": "delay", "link": [3, 5], "by": 70, "steps": [20, 140]},
        {"kind": "crash", "node": 3, "at": 40, "restart_after": 90},
        {"kind": "partition", "groups": [[1, 2, 3], [4, 5, 6, 7]], "steps": [20, 140]},
    ],
    ids=lambda outage: outage["kind"],
)
def test_a_long_outage_under_random_losses_is_made_up_for(outage: dict[str, Any]) -> None:
    topology = with_faults(read(PAPER), [*LOSSY, outage])
    ran = simulate(topology)
    np.testing.assert_array_equal(ran.report[:, 0], Plain(topology, ran).ahat())
    assert ran.end.forgotten == 0
    short = topology.model_copy(update={"history": 15})
    forgetful = simulate(short)
    assert forgetful.end.forgotten > 0
    assert forgetful.same_bits(simulate(short, layout(short, 1)))


def test_the_final_knowledge_of_the_estimator_is_the_same_as_without_losses() -> None:
    """Dropped messages touch no actuator under one candidate a node: so the same x, and after them the same report."""
    steady = read(PAPER, "law=hinf")
    lossless, lossy = simulate(steady), simulate(with_faults(steady, LOSSY))
    assert (lossless.x == lossy.x).all()


def test_without_back_filling_missed_rows_stay_missed() -> None:
    topology = with_faults(read(PAPER), [{"kind": "drop", "link": [3, 5], "steps": [0, 160]}], backfill=False)
    ran = simulate(topology)
    np.testing.assert_array_equal(ran.report[:, 0], Plain(topology, ran).ahat())
    assert (ran.report[:, 0, 4] == ran.report[0, 0, 4]).all()  # node 5 receives no messages: it never learns
