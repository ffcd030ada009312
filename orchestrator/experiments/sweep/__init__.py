"""Many runs of one network: every combination of some values, under every seed; a stopped sweep can be continued."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hedgerow.orchestrator.experiments.sweep import failures, summary
from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder, default_out
from hedgerow.orchestrator.experiments.sweep.plan import Plan
from hedgerow.orchestrator.experiments.sweep.progress import collect
from hedgerow.orchestrator.experiments.sweep.workers import over_processes
from hedgerow.orchestrator.metrics.verdict import EXIT_CODES, UNKNOWN, VALID
from hedgerow.topologies.describe import count
from hedgerow.topologies.errors import Code, Exit, UserError
from hedgerow.topologies.escape import echo


class Swept(NamedTuple):
    """The outcome of a sweep."""

    exit_code: Exit
    """0 if all runs are valid, 1 if one is not, 3 if one is unknown or the sweep was stopped"""
    line: str
    """the verdict over all runs, or the signal that stopped the sweep"""


def sweep(
    plan: Plan, out: Path | None = None, jobs: int | None = None, on: str | None = None, quiet: bool = False
) -> Swept:
    """Make the missing runs of a plan, then the table of all, its summary and its box plots.

    `on` is `ray` or ray://HOST:PORT; None for this machine, with `jobs` cores. `quiet` prints nothing. Raise UserError
    for a mistake, and HedgerowError if a run cannot be made.
    """
    with SweepFolder(plan, out or default_out(plan)) as folder:
        there = folder.there
        say = _nothing if quiet else echo
        if plan.engine == "in-process" and (why := sorted({one for one in plan.one_by_one if one})):
            some = sum(map(bool, plan.one_by_one))
            say(f"{some} of {len(plan.settings)} settings run one by one, which is slower: {'; '.join(why)}")
        say(f"{plan.name}: {_counted(plan)}, into {folder.path}" + (f"; {there} were there" if there else ""))
        if stopped := there < plan.runs and _run(plan, folder, jobs, on, quiet):
            line = f"stopped: {stopped}: {folder.there} of {plan.runs} runs are done; the same command continues"
            return Swept(EXIT_CODES[UNKNOWN], line)
        return _conclude(plan, folder, say)


def _nothing(text: str) -> None:
    pass


def _counted(plan: Plan) -> str:
    return f"{count(plan.runs, 'run')} ({count(len(plan.settings), 'setting')}, {count(len(plan.seeds), 'seed')})"


def _run(plan: Plan, folder: SweepFolder, jobs: int | None, on: str | None, quiet: bool) -> str:
    """Make the missing runs; return the signal that stopped them, or an empty text."""
    chunks = plan.chunks(frozenset(folder.rows))
    if on is not None:
        from hedgerow.orchestrator.experiments.sweep.on_ray import over_ray  # noqa: PLC0415

        answers = over_ray(plan, chunks, on, jobs)
    else:
        answers = over_processes(plan, chunks, jobs or (1 if plan.engine == "zenoh" else cores()))
    return collect(answers, folder, plan.runs, quiet)


def cores() -> int:
    """Return the number of available cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _conclude(plan: Plan, folder: SweepFolder, say: Callable[[str], None]) -> Swept:
    rows = [folder.asked(k) for k in range(len(plan.settings))]
    try:
        folder.write_table()
        summary.write_csv(folder.path / "summary.csv", plan, rows)
        drawn = _draw(plan, folder, rows)
    except OSError as error:
        raise UserError(
            f"{folder.path}: {error.strerror}; free space, then the same command continues", code=Code.OUTPUT
        ) from None
    verdicts = Counter(row["verdict"] for own in rows for row in own)
    worst = failures.worst(rows)
    say(summary.table(plan, rows))
    if any(map(summary.repeated, rows)):
        say(f"{summary.REPEATED}; one seed is enough")
    say(f"{folder.table}, summary.csv, {drawn}")
    for line in failures.lines(plan, rows):
        say(line)
    first = next(row for own in rows for row in own if row["verdict"] == worst)
    where = (
        "" if worst == VALID else f" (first seed {first['seed']}, {plan.label(first['setting'])}: {first['reasons']})"
    )
    return Swept(EXIT_CODES[worst], f"{worst}{where}: {verdicts[VALID]} of {plan.runs} runs valid")


def _draw(plan: Plan, folder: SweepFolder, rows: list[list[dict[str, object]]]) -> str:
    try:
        from hedgerow.orchestrator.experiments.sweep.boxes import write  # noqa: PLC0415
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        return "no box plots: matplotlib is not installed. Install it with: pip install matplotlib"
    write(folder.path, plan, rows)
    return "boxes.pdf and boxes.png beside it"
