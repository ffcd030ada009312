"""The runs of a comparison, and their results."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Row, rows_of
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.orchestrator.metrics.estimates import judged, switches
from hedgerow.orchestrator.metrics.observer import Batch, Observer, rows_at_once
from hedgerow.orchestrator.metrics.verdict import VALID, Ending, judge
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.runs.batch import Runs
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import End, Telemetry

METRICS = ("share_right", "error", "regret", "cost_regret", "gain", "switches")
"""the numbers of a row that are compared"""


def answer(plan: Plan, chunk: Chunk) -> Answer:
    """Return the rows of a chunk; an error travels as text, because the caller may be another process."""

    def alone(seed: int) -> Row:
        setting = plan.settings[chunk.setting].topology
        return _row(completed(resolve(setting.model_copy(update={"seed": seed}), plan.folder)))

    return rows_of(plan, chunk, alone, _row_at_once)


def _row_at_once(runs: Runs, k: int) -> Row:
    """Return the row of a run of a batch that passed every check."""
    values = {name: float(runs.metrics[name][k]) for name in ("regret", "cost_regret", "gain")}
    row: Row = {name: value if math.isfinite(value) else None for name, value in values.items()}
    row |= judged(runs.ahat[k], runs.a[k], runs.candidates[:, k])
    return {**row, "switches": float(runs.switches[k]), "verdict": VALID, "reasons": ""}


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
    if ending.stopped:  # sums over fewer steps would look better than those of a whole run
        row = dict.fromkeys(row)
    elif final is not None:
        estimates |= judged(final.ahat[-1], final.a[-1], topology.network.candidates)
        estimates["switches"] = changed / observer.graph.n
    return {**row, **estimates, "verdict": content["verdict"], "reasons": "; ".join(content["reasons"])}
