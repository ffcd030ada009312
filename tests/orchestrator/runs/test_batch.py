"""Many runs in one batch: the metrics of each equal those of a single run, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.experiments.sweep.plan import Chunk, plan
from hedgerow.orchestrator.experiments.sweep.runs import answer
from hedgerow.orchestrator.runs import batch
from hedgerow.topologies.named import resolved
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples
from tests.tools.networks import networks

LINE5 = "nodes={a: {x0: 2}, b: {candidates: [0.4, 0.6], a: 0.4}, c: {disturbance: {kind: white, std: 0.4}}, d: {}}"


@pytest.mark.parametrize(
    "sets",
    [
        ["law=minimax,hinf,nominal", "defaults.x0=0,15"],
        ["defaults.disturbance={kind: white, std: {random: [0.1, 1]}},none", "steps=1,40"],
        [
            "defaults.disturbance=[{kind: impulse, at: 3, value: 2}, {kind: constant, value: 0.1}]",
            "defaults.nominal=0.4",
        ],
        ["defaults.candidates={random: 1},{random: 7}"],
        [LINE5, "edges=[[a, b], [b, c], [c, a], [c, d]]", "lots=null", "defaults.x0={random: [-3, 3]}"],
    ],
    ids=["laws", "white", "impulse", "lists", "own nodes"],
)
def test_a_batch_gives_the_rows_of_single_runs(sets: list[str]) -> None:
    sweep = plan("paper7", "0:6", sets, "in-process")
    assert not any(sweep.one_by_one)
    for setting in range(len(sweep.settings)):
        together = answer(sweep, Chunk(setting, tuple(sweep.seeds)))
        alone = [answer(sweep, Chunk(setting, (seed,))) for seed in sweep.seeds]
        assert [row for one in alone for row in one] == together  # type: ignore[union-attr]


@given(topology=networks(most=5, steps=8), count=st.integers(2, 5))
@settings(max_examples=examples(40))
def test_any_network_gives_the_same_rows(topology: Topology, count: int) -> None:
    if batch.why_not(topology):
        return
    found = batch.run(topology, list(range(count)), Path())
    again = batch.run(topology, list(range(count))[::-1], Path())
    for name, values in found.metrics.items():
        assert values.tobytes() == again.metrics[name][::-1].tobytes(), name


def test_large_networks_are_run_by_themselves() -> None:
    line = {"name": "line", "b": 0.1, "steps": 5, "defaults": {"candidates": {"random": 3}}}
    assert not batch.why_not(resolved({**line, "graph": {"kind": "line", "nodes": 400}}))
    assert "400" in batch.why_not(resolved({**line, "graph": {"kind": "line", "nodes": 401}}))
