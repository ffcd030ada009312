"""One run of a sweep, and its row: the same numbers as in its verdict.json."""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hedgerow.agents.loading import LawError
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.law_source import need_same
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.orchestrator.metrics.observer import QUIET, Observer, rows_at_once
from hedgerow.orchestrator.metrics.verdict import VALID, Ending, judge
from hedgerow.orchestrator.runs import batch, reference
from hedgerow.orchestrator.runs.batch import Runs
from hedgerow.orchestrator.runs.union import SizesError
from hedgerow.topologies.errors import Code, HedgerowError, TopologyError, UserError
from hedgerow.topologies.json_file import read_json
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.message import End, Telemetry

Row = dict[str, Any]
METRICS = (
    *("regret", "regret_nominal", "cost", "cost_oracle", "cost_regret", "cost_ratio", "disturbance_energy"),
    *("gain", "gain_less_x0", "gamma_star", "rho", "nodes_right", "estimate_error"),
)
"""The metrics from verdict.json."""


@dataclass(frozen=True)
class Failure:
    """The reason why a chunk has no rows: the sweep cannot continue."""

    text: str
    users: bool
    """True for a mistake of the user"""
    code: Code = Code.UNKNOWN

    def error(self) -> HedgerowError:
        """Return the same as an error to raise."""
        return UserError(self.text, code=self.code) if self.users else HedgerowError(self.text, code=self.code)


Answer = list[Row] | Failure


def answer(plan: Plan, chunk: Chunk) -> Answer:
    """Return the rows of a chunk; an error is text, because the caller may be on another machine."""

    def alone(seed: int) -> Row:
        return _row(_content(plan, chunk.setting, seed))

    return rows_of(plan, chunk, alone, _row_at_once)


@QUIET
def rows_of(plan: Plan, chunk: Chunk, alone: Callable[[int], Row], at_once: Callable[[Runs, int], Row]) -> Answer:
    """Return the rows of a chunk, from one batch if possible.

    `alone` makes the run of a seed with every check. `at_once` reads the row of a run from a batch. A run that fails a
    check in a batch is made again alone, so its row gives the reason.
    """
    seed = chunk.seeds[0]
    try:
        need_same(plan.settings[chunk.setting].topology.law, plan.sources[chunk.setting].digest)
        together = None if plan.one_by_one[chunk.setting] or len(chunk.seeds) == 1 else _batch(plan, chunk)
        topology = plan.settings[chunk.setting].topology
        if together is not None and batch.needs_proof(topology):
            for k in (0, len(chunk.seeds) - 1):
                seed = chunk.seeds[k]
                if together is not None and together.good[k] and at_once(together, k) != alone(seed):
                    together = None
        found: list[Row] = []
        for k, seed in enumerate(chunk.seeds):
            row = alone(seed) if together is None or not together.good[k] else at_once(together, k)
            found.append({"setting": chunk.setting, "seed": seed, **row})
        return found
    except TopologyError as error:
        return Failure(f"seed {seed}, {plan.label(chunk.setting)}: {error.problems[0]}", users=True)
    except HedgerowError as error:
        return Failure(f"seed {seed}, {plan.label(chunk.setting)}: {error}", isinstance(error, UserError))
    except Exception as error:
        reached = limit_reached(error)
        where, code = f"seed {seed}, {plan.label(chunk.setting)}", Code.CRASH if reached is None else reached.code
        return Failure(f"{where}: {reached or crash.report(error)}", users=False, code=code)


def _batch(plan: Plan, chunk: Chunk) -> Runs | None:
    """Return the numbers of the runs of a chunk; None if they must be made one by one."""
    topology = plan.settings[chunk.setting].topology
    try:
        return batch.run(topology, chunk.seeds, plan.folder)
    except (LawError, SizesError, TopologyError):
        return None  # alone, each run reports its reason
    except Exception:
        if ":" not in topology.law:
            raise
        return None


def _row_at_once(runs: Runs, k: int) -> Row:
    """Return the row of a run that passed every check."""
    values = {name: float(runs.metrics[name][k]) for name in METRICS}
    row: Row = {name: value if math.isfinite(value) else None for name, value in values.items()}
    row["nodes_right"] = int(values["nodes_right"])
    return {**row, "share_right": row["nodes_right"] / runs.a.shape[1], "verdict": VALID, "reasons": ""}


def _content(plan: Plan, setting: int, seed: int) -> dict[str, Any]:
    """Return the content of verdict.json, with or without a file."""
    topology = completed(resolve(plan.settings[setting].topology.model_copy(update={"seed": seed}), plan.folder))
    return _over_zenoh(topology) if plan.engine == "zenoh" else run_here(topology)


def run_here(topology: Topology) -> dict[str, Any]:
    """Run a network in this process, without files on disk."""
    shards, observer = layout(topology, 1), Observer(topology)
    ending = Ending(run=topology.name, engine="in-process", processes=0)
    telemetry = reference.run(truth_of(topology, shards), views_of(topology, shards))
    try:
        while rows := list(itertools.islice(telemetry, rows_at_once(observer.graph.n))):
            if steps := [row for row in rows if isinstance(row, Telemetry)]:
                observer.take(steps)
            if isinstance(end := rows[-1], End):
                observer.finish(end)
    except LawError as error:
        ending.stopped = str(error)
    return judge(topology, observer, ending).content


def _over_zenoh(topology: Topology) -> dict[str, Any]:
    """Run a network by `orchestrator up`, with one process per agent."""
    from hedgerow.orchestrator.launch.running import run_to_the_end  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch) / "run"
        run_to_the_end(topology, folder, "--viewer", "none", "--no-record", listed=False)
        content: dict[str, Any] = read_json(folder / "verdict.json", folder)
    return content


def _row(content: dict[str, Any]) -> Row:
    metrics = content["metrics"]
    right = metrics.get("nodes_right")
    return {
        **{name: metrics.get(name) for name in METRICS},
        "share_right": None if right is None else right / content["nodes"],
        "verdict": content["verdict"],
        "reasons": "; ".join(content["reasons"]),
    }
