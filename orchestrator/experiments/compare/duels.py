"""Law against law: the tests of two laws under every disturbance, and how many each law wins."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from hedgerow.orchestrator.experiments.compare.plan import BESIDE
from hedgerow.orchestrator.experiments.compare.statistics import ORACLE, Paired
from hedgerow.topologies.describe import count

MOST_LAWS = 3
"""The number of laws up to which every pair is printed; tests.csv has the pairs of more laws."""
NOMINAL = "nominal"


@dataclass(frozen=True)
class Duel:
    """All tests of two laws."""

    one: str
    other: str
    tests: Sequence[Paired]
    """those with values of both laws, by disturbance and metric"""

    @property
    def better(self) -> int:
        """Return the number of tests in which `one` is certainly better."""
        return sum(test.decided and test.better == self.one for test in self.tests)

    @property
    def worse(self) -> int:
        """Return the number of tests in which `other` is certainly better."""
        return sum(test.decided and test.better == self.other for test in self.tests)

    @property
    def equal(self) -> int:
        """Return the number of tests with the same values of both laws for every seed."""
        return sum(test.wins == test.losses == 0 for test in self.tests)

    @property
    def uncertain(self) -> int:
        """Return the number of the other tests: the values differ, and no law is certainly better."""
        return len(self.tests) - self.better - self.worse - self.equal

    def __str__(self) -> str:
        if not self.better and not self.worse:
            same = f", {self.equal} of them equal for every seed" if self.equal else ""
            return f"{self.one}: no certain difference from {self.other} in {count(len(self.tests), 'test')}{same}"
        parts = [f"better than {self.other} in {self.better}", f"worse in {self.worse}"]
        parts += [f"equal in {self.equal}"] * (self.equal > 0)
        uncertain = f"; {count(self.uncertain, 'difference')} may be chance" if self.uncertain else ""
        return f"{self.one}: {', '.join(parts)} of {count(len(self.tests), 'test')}{uncertain}"


def duels(tests: Sequence[Paired]) -> list[Duel]:
    """Return the duels of the laws that were asked for, or of a single law and `nominal`; none of many laws.

    The oracle has no tests, and `nominal` is in every comparison.
    """
    laws = list(dict.fromkeys(law for test in tests for law in (test.one, test.other)))
    asked = [law for law in laws if law not in BESIDE]
    pairs = list(itertools.combinations(asked, 2)) if len(asked) <= MOST_LAWS else []
    if len(asked) == 1 and NOMINAL in laws and ORACLE not in asked:
        pairs = [(asked[0], NOMINAL)]
    return [Duel(*pair, [test for test in tests if {test.one, test.other} == {*pair} and test.pairs]) for pair in pairs]


def rows(duel: Duel, titles: dict[str, str]) -> list[list[str]]:
    """Return the table of a duel: headings, then a row per disturbance and metric."""
    return [
        ["disturbance", "metric", "better", "median difference", "seeds", "p by Holm", ""],
        *(
            [
                test.disturbance,
                titles[test.metric],
                test.better or "neither",
                "-" if math.isnan(test.difference) else f"{abs(test.difference):.3g}",
                _seeds(test),
                f"{test.holm:.2g}",
                "certain" if test.decided else "equal" if test.wins == test.losses == 0 else "may be chance",
            ]
            for test in duel.tests
        ),
    ]


def _seeds(test: Paired) -> str:
    """Return the number of seeds in which the better law has the better value, of those with values of both."""
    return f"{test.losses if test.better == test.other else test.wins} of {test.pairs}"
