"""The runs of a comparison, and the numbers that each leaves."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Failure, Row
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.orchestrator.metrics.observer import Batch, Observer, rows_at_once
from hedgerow.orchestrator.metrics.verdict import Ending, judge
from hedgerow.orchestrator.runs import reference
from hedgerow.topologies.errors import Code, HedgerowError, TopologyError, UserError
from hedgerow.topologies.graph import Array
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash
from hedgerow.wire.codec import End, Telemetry
from hedgerow.wire.limits import limit_reached

METRICS = ("share_right", "error", "regret", "cost_regret", "gain", "switches")
"""the numbers of a row that are compared"""


def answer(plan: Plan, chunk: Chunk) -> Answer:
    """Return the rows of a chunk; an error travels as text, because the caller may be another process."""
    where = f"seed {chunk.seeds[0]} and on, {plan.says(chunk.setting)}"
    try:
        setting = plan.settings[chunk.setting].topology
        drawn = [completed(resolve(setting.model_copy(update={"seed": seed}), plan.folder)) for seed in chunk.seeds]
        made = simulate_many(drawn)
        return [{"setting": chunk.setting, "seed": seed, **row} for seed, row in zip(chunk.seeds, made, strict=True)]
    except TopologyError as error:
        return Failure(f"{where}: {error.problems[0]}", users=True)
    except HedgerowError as error:
        return Failure(f"{where}: {error}", isinstance(error, UserError))
    except Exception as error:
        reached = limit_reached(error)
        code = Code.CRASH if reached is None else reached.code
        return Failure(f"{where}: {reached or crash.report(error)}", users=False, code=code)


def simulate_many(topologies: Sequence[Topology]) -> list[Row]:
    """Return the row of each resolved topology; all have the same law.

    Every run is made by itself here. An engine that makes many at once replaces this function.
    """
    return [_row(topology) for topology in topologies]


def _row(topology: Topology) -> Row:
    shards, observer = layout(topology, 1), Observer(topology)
    ending = Ending(run=topology.name, engine="in-process", processes=0)
    switches, last = 0.0, None
    final: Batch | None = None
    telemetry = reference.run(truth_of(topology, shards), views_of(topology, shards))
    try:
        while rows := list(itertools.islice(telemetry, rows_at_once(observer.graph.n))):
            if steps := [row for row in rows if isinstance(row, Telemetry)]:
                final = observer.take(steps)
                ahat = final.ahat if last is None else np.vstack([last, final.ahat])
                switches += _switches(ahat)
                last = final.ahat[-1]
            if isinstance(end := rows[-1], End):
                observer.finish(end)
    except LawError as error:
        ending.stopped = str(error)
    content = judge(topology, observer, ending).content
    metrics = content["metrics"]
    row: Row = {name: metrics.get(name) for name in ("regret", "cost_regret", "gain")}
    estimates: dict[str, Any] = {"share_right": None, "error": None, "switches": None}
    if final is not None:
        estimates = {**judged(final.ahat[-1], final.a[-1], topology.network.candidates)}
        estimates["switches"] = switches / observer.graph.n
    return {**row, **estimates, "verdict": content["verdict"], "reasons": "; ".join(content["reasons"])}


def judged(ahat: Array, a: Array, candidates: Array) -> dict[str, float | None]:
    """Return how good the estimates are, (n,) each; `candidates` (M, n).

    An estimate is right if the candidate nearest it is the truth. For an estimate from the list this is equality; for a
    real number it says which candidate it speaks for. A node without an estimate is not right, and has no error.
    """
    there = np.isfinite(ahat)
    apart = np.where(np.isnan(candidates), np.inf, np.abs(candidates - np.where(there, ahat, 0.0)))
    nearest = candidates[apart.argmin(axis=0), np.arange(len(a))]
    error = np.abs(ahat - a)[there]
    return {
        "share_right": float(((nearest == a) & there).mean()),
        "error": float(error.mean()) if len(error) else None,
    }


def _switches(ahat: Array) -> float:
    """Return how often the estimates of all nodes change, over rows (B, n); a missing estimate changes nothing."""
    one, other = ahat[:-1], ahat[1:]
    return float(((one != other) & np.isfinite(one) & np.isfinite(other)).sum())
