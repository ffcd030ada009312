"""A recorded run computed again: by the observer, and by the file and the law."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.metrics.replay import Finding, Replay
from hedgerow.orchestrator.runs.recomputed import TABLES, first_other
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.wire.message import TAKEN, End, Telemetry

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.run import Run

_ROWS_AT_ONCE = 1024


DYNAMICS = "dynamics"


def first_difference(run: Run) -> Finding | None:
    """Return the first difference between a run and its replay by the file, the law and the observer; see `Run`."""
    run.need_all("a replay")
    done = run.verdict.content.get("steps_done")
    if isinstance(done, int) and done != run.T:
        return Finding(
            TABLES, min(done, run.T), None, [f"the tables hold {run.T} steps, and the verdict counts {done}"]
        )
    return _first_replayed(run) or _first_computed(run)


def _first_computed(run: Run) -> Finding | None:
    """Return the first difference between the tables and the observer's numbers for the same telemetry."""
    batch, observer = observe(run)
    moved = observer.checks["dynamics"]
    if moved.excess > 0:
        node = None if moved.node < 0 else run.topology.ids[moved.node]
        return Finding(DYNAMICS, moved.step, node, [moved.why or "the next state does not follow from this one"])
    return first_other(run, batch, observer)


def _first_replayed(run: Run) -> Finding | None:
    links = run.received.view(np.uint8)
    report = np.stack([run.ahat, run.margin], axis=1)
    replay = Replay(run.topology, receipts=False)
    replay.take(
        [
            Telemetry(t, run.x[t], run.u[t], run.w[t], report[t], run.edge_open[t].view(np.uint8), links[t], links[t])
            for t in run.recorded[run.recorded < run.T].tolist()
        ]
    )
    if replay.doubt:
        raise HedgerowError(f"{run.folder}: {replay.doubt}", code=Code.UNKNOWN)
    return replay.finding


def observe(run: Run) -> tuple[Batch, Observer]:
    """Return all rows that the observer computes from the telemetry of a run, and the observer.

    Raise UserError if not all rows were recorded, or if topology.yaml belongs to another run.
    """
    run.need_all("an array that is computed from every node")
    observer = Observer(run.topology)
    steps = run.recorded[run.recorded < run.T]
    # The received messages affect none of these numbers.
    links = 2 * len(run.edges)
    received, used = np.ones(links, dtype=np.uint8), np.full(links, TAKEN, dtype=np.uint8)
    report = np.stack([run.ahat, run.margin], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow shows as an infinite number
        batches = [
            observer.take(
                [
                    Telemetry(int(t), run.x[t], run.u[t], run.w[t], report[t], run.edge_open[t], received, used)
                    for t in part
                ]
            )
            for part in np.array_split(steps, -(-len(steps) // _ROWS_AT_ONCE))
        ]
        observer.finish(End(run.T, run.x[-1], 0.0))
    whole = {one.name: np.concatenate([getattr(batch, one.name) for batch in batches]) for one in fields(Batch)}
    batch = Batch(**whole)
    if not np.array_equal(batch.x_oracle, run.x_oracle[steps], equal_nan=True):
        raise UserError(f"{run.folder}: topology.yaml is not that of this telemetry", code=Code.FILE_FORMAT)
    return batch, observer
