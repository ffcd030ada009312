"""The runs of a comparison, and their results."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.compare import batch
from hedgerow.orchestrator.experiments.compare.estimates import judged, switches
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Failure, Row
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.law_source import need_same
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.orchestrator.metrics.observer import Batch, Observer, rows_at_once
from hedgerow.orchestrator.metrics.verdict import VALID, Ending, judge
from hedgerow.orchestrator.runs import reference
from hedgerow.topologies.errors import Code, HedgerowError, TopologyError, UserError
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
        need_same(setting.law, plan.sources[chunk.setting].digest)
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

    They are made in one batch if possible. If a number grows beyond all bounds, the run is made again alone, with every
    check, so its row gives the reason.
    """
    if len(topologies) == 1 or batch.why_not(topologies):
        return [_row(topology) for topology in topologies]
    return [
        _row(topology) if row["switches"] is None else {**row, "verdict": VALID, "reasons": ""}
        for topology, row in zip(topologies, batch.Many(topologies).run(), strict=True)
    ]


def _row(topology: Topology) -> Row:
    shards, observer = layout(topology, 1), Observer(topology)
    ending = Ending(run=topology.name, engine="in-process", processes=0)
    changed, last = 0.0, None
    final: Batch | None = None
    telemetry = reference.run(truth_of(topology, shards), views_of(topology, shards))
    try:
        while rows := list(itertools.islice(telemetry, rows_at_once(observer.graph.n))):
            if steps := [row for row in rows if isinstance(row, Telemetry)]:
                final = observer.take(steps)
                ahat = final.ahat if last is None else np.vstack([last, final.ahat])
                changed += float(switches(ahat[:-1], ahat[1:]).sum())
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
        estimates |= judged(final.ahat[-1], final.a[-1], topology.network.candidates)
        estimates["switches"] = changed / observer.graph.n
    return {**row, **estimates, "verdict": content["verdict"], "reasons": "; ".join(content["reasons"])}
