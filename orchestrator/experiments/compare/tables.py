"""A comparison in words and in tables, all of it computed from its numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hedgerow.orchestrator.experiments.compare.duels import duels, rows
from hedgerow.orchestrator.experiments.compare.runs import METRICS
from hedgerow.orchestrator.experiments.compare.statistics import (
    HIGHER_IS_BETTER,
    LEVEL,
    ORACLE,
    Cell,
    Paired,
    least_p,
    pairs_needed,
)

TITLES = {
    "share_right": "nodes right",
    "error": "|ahat - a|",
    "regret": "regret D",
    "cost_regret": "cost regret",
    "gain": "gain",
    "switches": "switches",
}
"""By metric: the heading of its column."""


def number(cell: Cell) -> str:
    """Return the mean of a cell and half of its interval."""
    if math.isnan(cell.mean):
        return "undefined"
    if math.isnan(cell.half):
        return f"{cell.mean:.3g}"
    # The interval determines the digits: show two digits of it.
    digits = 2 if cell.half == 0 else min(6, max(0, 1 - math.floor(math.log10(cell.half))))
    return f"{cell.mean:.{digits}f} ± {cell.half:.{digits}f}"


def grid(cells: Sequence[Cell], disturbance: str) -> list[list[str]]:
    """Return the table of one disturbance: headings, then a row per law."""
    own = [cell for cell in cells if cell.disturbance == disturbance]
    laws = list(dict.fromkeys(cell.law for cell in own))
    of = {(cell.law, cell.metric): cell for cell in own}
    return [
        ["law", *(TITLES[metric] for metric in METRICS)],
        *([law, *(number(of[law, metric]) for metric in METRICS)] for law in laws),
    ]


def text(cells: Sequence[Cell]) -> str:
    """Return every table for the screen."""
    return "\n\n".join(f"{disturbance}\n{_aligned(grid(cells, disturbance))}" for disturbance in _disturbances(cells))


def markdown(cells: Sequence[Cell], tests: Sequence[Paired]) -> str:
    """Return every table and the words as a page in Markdown."""
    parts = []
    for disturbance in _disturbances(cells):
        heading, *rows = grid(cells, disturbance)
        lines = [heading, ["---"] * len(heading), *rows]
        table = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        listed = "\n".join(f"- {line}" for line in findings(cells, tests, disturbance))
        parts.append(f"## {disturbance}\n\n{table}\n\n{listed}\n")
    if found := duels(tests):
        parts.append("## Law against law\n\n" + "\n".join(f"- {duel}" for duel in found) + "\n")
    return "\n".join(parts)


def conclusions(cells: Sequence[Cell], tests: Sequence[Paired]) -> str:
    """Return the findings under every disturbance."""
    return "\n".join(
        f"{disturbance}: {line}" for disturbance in _disturbances(cells) for line in findings(cells, tests, disturbance)
    )


def against(tests: Sequence[Paired]) -> str:
    """Return the table of every duel and its result, law against law; empty for many laws."""
    found = duels(tests)
    parts = [f"{duel.one} against {duel.other}\n{_aligned(rows(duel, TITLES))}" for duel in found if duel.tests]
    return "\n\n".join([*parts, "\n".join(map(str, found))]) if found else ""


def findings(cells: Sequence[Cell], tests: Sequence[Paired], disturbance: str) -> list[str]:
    """Return a sentence per metric: the first law, the laws that it beats, and the others.

    A law beats another one if the corrected test is significant. The first law has the best mean among the laws that no
    other law beats. It is called best only if it beats all others, except those with its values in every run.
    """
    found = []
    for metric in METRICS:
        if metric == "switches":
            continue
        own = [
            cell
            for cell in cells
            if (cell.disturbance, cell.metric) == (disturbance, metric) and cell.law != ORACLE and cell.n
        ]
        if not own:
            found.append(f"{TITLES[metric]} is undefined")
            continue
        beaten = {
            (test.better, test.other if test.better == test.one else test.one)
            for test in tests
            if (test.disturbance, test.metric) == (disturbance, metric) and test.decided
        }
        losers = {law for _, law in beaten}
        sign = 1.0 if metric in HIGHER_IS_BETTER else -1.0
        best = max(own, key=lambda cell: (cell.law not in losers, sign * cell.mean))
        under = [cell.law for cell in own if (best.law, cell.law) in beaten]
        others = [cell for cell in own if cell.law != best.law and cell.law not in under]
        same = [cell.law for cell in others if np.array_equal(cell.values, best.values, equal_nan=True)]
        level = [cell.law for cell in others if cell.law not in same]
        found.append(f"{TITLES[metric]}: {_sentence(best, under, same, level)}")
    return found


def _sentence(best: Cell, under: Sequence[str], same: Sequence[str], level: Sequence[str]) -> str:
    """Return the finding of one metric: the laws that the first law beats, equals, and is not distinguishable from."""
    if not under and not level:
        return f"all laws are equal ({number(best)})" if same else f"{best.law} alone has a value ({number(best)})"
    if not under:
        return f"no test finds a difference; {best.law} has the best mean ({number(best)})"
    sentence = (
        f"{best.law} {'has the best mean' if level else 'is best'} ({number(best)}), better than {_listed(under)}"
    )
    if same:
        sentence += f"; equal to {_listed(same)}"
    if level:
        sentence += f"; not distinguishable from {_listed(level)}"
    return sentence


def method(seeds: int, count: int) -> str:
    """Return the method behind the numbers, in tables."""
    return (
        f"mean over {seeds} seeds ± half of its {LEVEL:.0%} interval; {count} paired Wilcoxon tests over seeds,"
        " corrected by Holm"
    )


def shortage(tests: Sequence[Paired]) -> str:
    """Return the warning that the seeds are too few for any test; empty if they are enough."""
    if (needed := pairs_needed(tests)) is None:
        return ""
    pairs, count = max(test.pairs for test in tests), len(tests)
    return (
        f"too few seeds: with {pairs} seeds p is at least {least_p(pairs):.2g}, and {count} tests need"
        f" {(1 - LEVEL) / count:.2g}; no law can be best below {needed} seeds"
    )


def _disturbances(cells: Sequence[Cell]) -> list[str]:
    return list(dict.fromkeys(cell.disturbance for cell in cells))


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _aligned(lines: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = (itertools.starmap(str.ljust, zip(line, widths, strict=True)) for line in lines)
    return "\n".join("  ".join(row).rstrip() for row in padded)
