"""Recorded runs of some networks, and comparisons by the bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.networks import read

NAMED = """
name: named
b: 0.1
steps: 12
seed: 5
defaults: {x0: 3, disturbance: {kind: white, std: 0.1}}
nodes: {upper_dam: {candidates: {random: 2}}, NA: {}, 3: {}}
edges: [[upper_dam, 3], [3, NA]]
faults:
- {kind: drop, from: 3, to: upper_dam, steps: [2, 5]}
- {kind: actuator, node: upper_dam, steps: [4, 6]}
- {kind: crash, node: 3, at: 6, restart_after: 2}
"""


HUGE = f"{{name: huge, b: 0.1, steps: 3, nodes: [{2**62 + 1}, {-(2**62) - 1}], edges: [[{2**62 + 1}, {-(2**62) - 1}]]}}"


ALONE = "{name: alone, b: 0.1, steps: 3, nodes: [1]}"


NETWORKS: dict[str, Callable[[], Topology]] = {
    "paper7": lambda: resolve(load("paper7")),
    "named": lambda: read(NAMED),
    "huge": lambda: read(HUGE),
    "alone": lambda: read(ALONE),
}


def ran(topology: Topology, folder: Path) -> Run:
    """A run of a network in this process, to its end."""
    simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    return load_run(folder)


def same(one: Any, other: Any) -> bool:
    """Every bit; a NaN is a NaN."""
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    if one.dtype.kind == "f":
        return bool((np.isnan(one) == np.isnan(other)).all()) and same(
            *(np.nan_to_num(values, nan=0.5).view(np.int64) for values in (one, other))
        )
    return bool((one == other).all())


OBSERVED = ("x", "u", "w", "x_oracle", "x_nominal", "regret", "nominal_gap")
"""The arrays of Run that may also have the final state."""


COMPUTED = (
    "a",
    "ahat",
    "index",
    "a_ls",
    "beta",
    "right",
    "cost",
    "cost_oracle",
    "cost_sum",
    "cost_oracle_sum",
    "energy_sum",
)


def assert_as_live(run: Run, live: Batch, observer: Observer) -> None:
    """Check that the run has the bits of the observer at the steps of `live`."""
    for name in OBSERVED:
        assert same(getattr(run, name)[live.t], getattr(live, name)), name
    for name in (*COMPUTED, "u_edge", "cost_regret"):
        assert same(getattr(run, name)[live.t], getattr(live, name)), name
    assert same(run.edge_open[live.t], live.edge_open)
    assert same(run.gain[live.t], live.gain())
    assert same(run.gain_less_x0[live.t], live.gain(observer.v0))
    assert same(run.regret_sum[live.t], live.regret_sum)
    assert same(run.nominal_regret_sum[live.t], live.nominal_regret_sum)
    assert (run.regret_sum[-1], run.nominal_regret_sum[-1]) == (observer.regret_sum, observer.nominal_regret_sum)
    assert run.gamma_star == observer.gamma_star
    if observer.end is not None:
        assert same(run.x[-1], observer.end.x)
        assert same(run.x_oracle[-1], observer.x_oracle_end)
