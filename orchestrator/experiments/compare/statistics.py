"""Means with their intervals over seeds, and paired tests between laws, corrected for their number."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hedgerow.orchestrator.experiments.compare.plan import Comparison
from hedgerow.orchestrator.experiments.compare.runs import METRICS
from hedgerow.orchestrator.experiments.sweep import summary
from hedgerow.orchestrator.experiments.sweep.runs import Row
from hedgerow.topologies.graph import Array

LEVEL = 0.95
"""the confidence of every interval; 1 - LEVEL is the error probability of all tests together"""
HIGHER_IS_BETTER = frozenset({"share_right"})
ORACLE = "hinf"
"""The oracle knows the truth: it is shown, and never wins."""


@dataclass(frozen=True)
class Cell:
    """A metric of one law under one disturbance."""

    disturbance: str
    law: str
    metric: str
    values: Array
    """the values by seed, NaN where undefined, (S,)"""

    @property
    def n(self) -> int:
        """Return the number of seeds with a value."""
        return int(np.isfinite(self.values).sum())

    @property
    def mean(self) -> float:
        """Return the mean over seeds; NaN if there is none."""
        return float(np.nanmean(self.values)) if self.n else np.nan

    @property
    def half(self) -> float:
        """Return half the width of the interval of the mean, by Student's t over seeds; NaN for one seed."""
        if self.n < 2:
            return float("nan")
        from scipy import stats  # noqa: PLC0415 (a second, and every `import hedgerow` would pay it)

        error = float(np.nanstd(self.values, ddof=1)) / self.n**0.5
        return float(stats.t.ppf(0.5 + LEVEL / 2, self.n - 1) * error)


@dataclass(frozen=True)
class Paired:
    """A paired Wilcoxon signed-rank test of two laws, over the seeds with values of both."""

    disturbance: str
    metric: str
    one: str
    other: str
    pairs: int
    better: str
    """the law with the better median difference; empty if neither is better"""
    p: float
    holm: float
    """p corrected for all tests of the comparison"""
    difference: float = float("nan")
    """the median over the pairs of the values of `one` less those of `other`; NaN without a pair"""
    wins: int = 0
    """the number of pairs in which `one` has the better value"""
    losses: int = 0
    """the number of pairs in which `other` has the better value"""

    @property
    def decided(self) -> bool:
        """Return True if one law is better."""
        return bool(self.better) and self.holm < 1 - LEVEL


def cells(plan: Comparison, rows: Sequence[Sequence[Row]]) -> list[Cell]:
    """Return every cell; `rows` are the runs of each setting, by seed.

    If the seeds of a disturbance repeat one run, it counts once: a test would take the copies for evidence.
    """
    once = repeats(plan, rows)
    return [
        Cell(
            setting.values[0],
            setting.values[1],
            metric,
            np.array([np.nan if row[metric] is None else row[metric] for row in own], float)[
                : 1 if setting.values[0] in once else None
            ],
        )
        for setting, own in zip(plan.settings, rows, strict=True)
        for metric in METRICS
    ]


def repeats(plan: Comparison, rows: Sequence[Sequence[Row]]) -> list[str]:
    """Return the disturbances under which every law gave the same run for all seeds."""
    drawn = {setting.values[0] for setting, own in zip(plan.settings, rows, strict=True) if not summary.repeated(own)}
    return [disturbance for disturbance in plan.disturbances if disturbance not in drawn]


def paired(found: Sequence[Cell]) -> list[Paired]:
    """Return a test for every pair of laws except the oracle, under every disturbance, for every metric except
    `switches`.
    """
    of: dict[tuple[str, str], list[Cell]] = {}
    for cell in found:
        if cell.law != ORACLE and cell.metric != "switches":
            of.setdefault((cell.disturbance, cell.metric), []).append(cell)
    made = [_tested(one, other) for own in of.values() for one, other in itertools.combinations(own, 2)]
    corrected = holm(np.array([test.p for test in made]))
    return [Paired(**{**vars(test), "holm": float(p)}) for test, p in zip(made, corrected, strict=True)]


def least_p(pairs: int) -> float:
    """Return the smallest p that the exact test can give: all differences of the pairs have one sign, 2^(1 - n)."""
    return min(1.0, 2.0 ** (1 - pairs))


def pairs_needed(tests: Sequence[Paired]) -> int | None:
    """Return the number of pairs that one decided test needs; None if the tests have as many, or one is decided.

    Holm multiplies the smallest p by the number of tests. If the product is above the level for every possible
    outcome, the comparison cannot find a better law.
    """
    if not tests or any(test.decided for test in tests):
        return None
    if max(test.pairs for test in tests) >= (needed := _pairs_for(len(tests))):
        return None
    return needed


def _pairs_for(tests: int) -> int:
    return next(n for n in itertools.count(1) if least_p(n) * tests < 1 - LEVEL)


def _tested(one: Cell, other: Cell) -> Paired:
    from scipy import stats  # noqa: PLC0415

    apart = one.values - other.values
    apart = apart[np.isfinite(apart)]
    sign = 1.0 if one.metric in HIGHER_IS_BETTER else -1.0
    p, better = 1.0, ""
    if apart.any():
        ranks = stats.rankdata(np.abs(apart[apart != 0])) * np.sign(apart[apart != 0])
        better = "" if ranks.sum() == 0 else one.law if sign * ranks.sum() > 0 else other.law
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a warning about few pairs; p shows the same
            p = float(stats.wilcoxon(apart).pvalue)
    return Paired(
        one.disturbance,
        one.metric,
        one.law,
        other.law,
        len(apart),
        better,
        p if np.isfinite(p) else 1.0,
        1.0,
        float(np.median(apart)) if len(apart) else np.nan,
        int((sign * apart > 0).sum()),
        int((sign * apart < 0).sum()),
    )


def holm(p: Array) -> Array:
    """Return p-values corrected by Holm's step-down method, which holds for any dependence."""
    order = p.argsort(kind="stable")
    left = len(p) - np.arange(len(p))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * left)) if len(p) else p
    return corrected
