"""Laws compared on one network: the same seeds for all, intervals, paired tests, one table and one figure."""

from __future__ import annotations

import csv
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from hedgerow.orchestrator.experiments.compare import tables
from hedgerow.orchestrator.experiments.compare.duels import Duel, duels
from hedgerow.orchestrator.experiments.compare.plan import Comparison
from hedgerow.orchestrator.experiments.compare.runs import METRICS, answer
from hedgerow.orchestrator.experiments.compare.statistics import (
    Cell,
    Paired,
    cells,
    paired,
    pairs_needed,
    repeats,
)
from hedgerow.orchestrator.experiments.sweep import cores, failures
from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder
from hedgerow.orchestrator.experiments.sweep.progress import collect
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Row
from hedgerow.orchestrator.experiments.sweep.summary import REPEATED
from hedgerow.orchestrator.experiments.sweep.workers import over_processes
from hedgerow.topologies.describe import count
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import echo

DIFFERENCE = ("difference", "wins", "losses")
"""the last columns of tests.csv: the median of one - other, and the seeds in which `one` or `other` is better"""


@dataclass(frozen=True)
class Compared:
    """A finished comparison; `print` shows its tables and its findings."""

    plan: Comparison
    """the laws, disturbances and seeds"""
    rows: Sequence[Sequence[Row]]
    """the runs of each setting of the plan, by seed"""
    folder: Path
    """the folder of the results"""
    seeds_there: int = 0
    """the number of seeds of the runs in the folder; the tables have those of the plan only"""

    @cached_property
    def cells(self) -> list[Cell]:
        """Return every metric of every law under every disturbance, with its values by seed."""
        return cells(self.plan, self.rows)

    @cached_property
    def tests(self) -> list[Paired]:
        """Return the paired tests."""
        return paired(self.cells)

    @property
    def duels(self) -> list[Duel]:
        """Return the results law against law, for up to three laws; a single law is compared with `nominal`."""
        return duels(self.tests)

    @property
    def method(self) -> str:
        """Return how the numbers were made, in one line."""
        said = tables.method(len(self.plan.seeds), len(self.tests))
        once = repeats(self.plan, self.rows)
        said += f"; under {', '.join(once)}, {REPEATED}: it counts once" if once else ""
        if self.seeds_there > len(self.plan.seeds):
            said += f"; the folder has runs of {self.seeds_there} seeds"
        return said if self.seeds_needed is None else f"{said}\n{tables.shortage(self.tests)}"

    @property
    def seeds_needed(self) -> int | None:
        """Return the seeds from which a test can find a better law; None if there are enough, or all give one run."""
        if len(repeats(self.plan, self.rows)) == len(self.plan.disturbances):
            return None
        return pairs_needed(self.tests)

    @property
    def markdown(self) -> str:
        """Return tables and findings in Markdown."""
        return f"# {self.plan.name}\n\n{self.method}.\n\n{tables.markdown(self.cells, self.tests)}"

    def __repr__(self) -> str:
        laws, under = ", ".join(self.plan.laws), ", ".join(self.plan.disturbances)
        return f"<Compared {self.plan.name}: {laws} under {under}, {len(self.plan.seeds)} seeds; print it>"

    def __str__(self) -> str:
        parts = [tables.text(self.cells), tables.conclusions(self.cells, self.tests), self.method]
        return "\n\n".join([*parts, *filter(None, [tables.against(self.tests)])])

    def mean(self, law: str, metric: str, disturbance: str = "") -> float:
        """Return a mean over seeds; `disturbance` may be omitted if there is one.

        Raises UserError for an unknown name.
        """
        where = disturbance or self.plan.disturbances[0]
        found = [one for one in self.cells if (one.disturbance, one.law, one.metric) == (where, law, metric)]
        if not found:
            known = {
                "disturbance": (where, [one.disturbance for one in self.cells]),
                "law": (law, [one.law for one in self.cells]),
                "metric": (metric, [one.metric for one in self.cells]),
            }
            for noun, (given, names) in known.items():
                if given not in names:
                    listed = ", ".join(dict.fromkeys(names))
                    raise UserError(
                        f"{noun}={given!r}: is not in this comparison. Choose one of {listed}.", code=Code.OPTION
                    )
            raise UserError(f"{metric} of {law} under {where}: has no mean in this comparison.", code=Code.OPTION)
        return found[0].mean

    @property
    def exit_code(self) -> int:
        """Return 0 if all runs are valid, 1 if one is not, 3 if one is unknown."""
        return failures.exit_code(self.rows)

    @property
    def not_valid(self) -> list[str]:
        """Return one line per law and disturbance with runs that are not valid: their seeds and the first reasons."""
        return failures.lines(self.plan, self.rows)


def compare(plan: Comparison, out: Path | None = None, jobs: int | None = None, quiet: bool = False) -> Compared | None:
    """Make the missing runs, then the table, the findings and the figure.

    Return None if the comparison was stopped; the finished runs are saved.

    `jobs` is the number of processes, all cores by default; with 1, the runs are made in this process. Raise UserError
    for a mistake, and HedgerowError if a run cannot be made.
    """
    with SweepFolder(plan, out or plan.default_out, METRICS) as folder:
        there = folder.there
        if not quiet:
            things = (("law", plan.laws), ("disturbance", plan.disturbances), ("seed", plan.seeds))
            counts = ", ".join(count(len(some), thing) for thing, some in things)
            echo(f"{plan.name}: {counts}, into {folder.path}" + (f"; {there} of {plan.runs} were there" * (there > 0)))
        if there < plan.runs and (stopped := _run(plan, folder, jobs or cores(), quiet)):
            echo(f"stopped: {stopped}: {folder.there} of {plan.runs} runs are done; the same command continues")
            return None
        asked = [folder.asked(k) for k in range(len(plan.settings))]
        found = Compared(plan, asked, folder.path, len({seed for _, seed in folder.rows}))
        try:
            _write(found)
        except OSError as error:
            raise UserError(
                f"{folder.path}: {error.strerror}; free space, then the same command continues", code=Code.OUTPUT
            ) from None
        return found


def _run(plan: Comparison, folder: SweepFolder, jobs: int, quiet: bool) -> str:
    """Make the missing runs; return the signal that stopped it, or an empty text."""
    chunks = plan.chunks(frozenset(folder.rows))
    answers: Generator[Answer | None, None, None]
    answers = over_processes(plan, chunks, jobs, answer) if jobs > 1 else (answer(plan, chunk) for chunk in chunks)
    return collect(answers, folder, plan.runs, quiet)


def _write(found: Compared) -> None:
    """Write the table of runs, the means, the tests, the page and the figure."""
    from hedgerow.orchestrator.experiments.compare.figure import write  # noqa: PLC0415

    folder, plan = found.folder, found.plan
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        line = csv.writer(file).writerow
        line(["disturbance", "law", "seed", *METRICS, "verdict"])
        for setting, own in zip(plan.settings, found.rows, strict=True):
            for row in own:
                line([*setting.values, row["seed"], *(row[metric] for metric in METRICS), row["verdict"]])
    with (folder / "means.csv").open("w", newline="", encoding="utf-8") as file:
        line = csv.writer(file).writerow
        line(["disturbance", "law", "metric", "seeds", "mean", "low", "high"])
        for cell in found.cells:
            low, high = cell.mean - cell.half, cell.mean + cell.half
            line([cell.disturbance, cell.law, cell.metric, cell.n, cell.mean, low, high])
    with (folder / "tests.csv").open("w", newline="", encoding="utf-8") as file:
        line = csv.writer(file).writerow
        line(["disturbance", "metric", "one", "other", "pairs", "better", "p", "holm", *DIFFERENCE])
        for test in found.tests:
            tested = [test.disturbance, test.metric, test.one, test.other, test.pairs, test.better, test.p, test.holm]
            line([*tested, *(getattr(test, name) for name in DIFFERENCE)])
    (folder / "compare.md").write_text(found.markdown, encoding="utf-8")
    write(folder, found.cells, f"{plan.name}: {plan.runs} runs")
