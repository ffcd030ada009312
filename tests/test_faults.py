"""Faults in one process: what they do to the plant, to what nodes know, and to nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.assign import candidates_of, layout
from tests.networks import networks, partitions, read, simulate
from tests.schedules import Plain, schedules, with_faults
from topologies.hinf import contraction
from topologies.schema import Topology


@st.composite
def faulty(draw: st.DrawFn, most: int = 5, steps: int = 14) -> Topology:
    """Any network under any schedule, with back-filling or without."""
    topology = draw(networks(most=most, steps=steps))
    return with_faults(topology, draw(schedules(topology)), backfill=draw(st.sampled_from([True, True, False])))


@given(topology=faulty(), history=st.sampled_from([1, 2, 5, 100_000]), data=st.data())
def test_faults_mean_the_same_in_every_layout(topology: Topology, history: int, data: st.DataObject) -> None:
    topology = topology.model_copy(update={"history": history})
    assert simulate(topology, data.draw(partitions(len(topology.ids)))).same_bits(simulate(topology))


@given(faulty())
def test_every_node_knows_what_the_plain_rules_say(topology: Topology) -> None:
    """Estimates after every gap, late message, crash and restart are those of the same samples without the gap."""
    ran = simulate(topology)
    np.testing.assert_array_equal(ran.report[:, :, 0], Plain(topology, ran).ahat())


@given(faulty())
def test_the_contraction_holds_and_no_missing_input_flows(topology: Topology) -> None:
    ran, graph, models = simulate(topology), topology.graph, candidates_of(topology)
    # Before a jump and after it the truth is one of the candidates: the largest bounds them all.
    rho = contraction(np.nanmax(models, axis=0), models)
    for row, x_next in zip(ran.rows, ran.x[1:], strict=True):
        norm = np.abs(row.x).sum()
        assert np.abs(x_next).sum() <= rho * norm + np.abs(row.w).sum() + 1e-9 * (1 + norm)
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
    np.testing.assert_array_equal(ran.report[:, :, 0], Plain(topology, ran).ahat())
    assert ran.end.forgotten == 0
    short = topology.model_copy(update={"history": 15})
    forgetful = simulate(short)
    assert forgetful.end.forgotten > 0
    assert forgetful.same_bits(simulate(short, layout(short, 1)))


def test_what_the_estimator_knows_at_the_end_is_what_it_knows_without_losses() -> None:
    """Dropped messages touch no actuator under one candidate a node: so the same x, and after them the same report."""
    steady = read(PAPER, "law=hinf")
    lossless, lossy = simulate(steady), simulate(with_faults(steady, LOSSY))
    assert (lossless.x == lossy.x).all()


def test_without_back_filling_what_was_missed_stays_missed() -> None:
    topology = with_faults(read(PAPER), [{"kind": "drop", "link": [3, 5], "steps": [0, 160]}], backfill=False)
    ran = simulate(topology)
    np.testing.assert_array_equal(ran.report[:, :, 0], Plain(topology, ran).ahat())
    assert (ran.report[:, 4, 0] == ran.report[0, 4, 0]).all()  # node 5 hears nobody: it never learns
