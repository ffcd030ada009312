"""Law against law: a duel counts the tests of two laws, and a difference is certain if its test is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.agents.law import Array
from hedgerow.orchestrator.experiments.compare.duels import MOST_LAWS, duels, rows
from hedgerow.orchestrator.experiments.compare.statistics import Cell, paired
from hedgerow.orchestrator.experiments.compare.tables import TITLES, against

LOW = np.linspace(1.0, 1.2, 30)
NOISE = np.random.default_rng(1).normal(size=30)


def cells(**values: Array) -> list[Cell]:
    return [Cell("white", law, "regret", own) for law, own in values.items()]


def test_a_duel_counts_the_certain_tests_of_both_laws_and_the_others() -> None:
    made = cells(mine=LOW, paper=LOW + 5) + [
        Cell("white", law, metric, own)
        for metric, pair in {"gain": (LOW + 5, LOW), "error": (LOW, LOW), "cost_regret": (LOW, LOW + NOISE)}.items()
        for law, own in zip(("mine", "paper"), pair, strict=True)
    ]
    (duel,) = duels(paired(made))
    assert (duel.one, duel.other) == ("mine", "paper")
    assert (duel.better, duel.worse, duel.equal, duel.uncertain) == (1, 1, 1, 1)


def test_a_duel_has_the_median_difference_and_the_seeds_that_each_law_wins() -> None:
    values = np.array([1.0, 1.0, 1.0, 1.0, np.nan])
    (duel,) = duels(paired(cells(mine=values, paper=np.array([2.0, 4.0, 0.5, 1.0, 1.0]))))
    (test,) = duel.tests
    assert (test.wins, test.losses, test.pairs) == (2, 1, 4)
    assert test.difference == pytest.approx(-0.5)


def test_more_of_nodes_that_are_right_is_better() -> None:
    made = [Cell("white", law, "share_right", own) for law, own in {"mine": LOW, "paper": LOW + 1}.items()]
    (duel,) = duels(paired(made))
    assert (duel.better, duel.worse) == (0, 1)
    assert (duel.tests[0].wins, duel.tests[0].losses) == (0, 30)


@pytest.mark.parametrize(
    ("laws", "pairs"),
    [
        (["mine", "hinf", "nominal"], [("mine", "nominal")]),
        (["mine", "paper", "hinf", "nominal"], [("mine", "paper")]),
        (["a", "b", "c", "nominal"], [("a", "b"), ("a", "c"), ("b", "c")]),
        (["a", "b", "c", "d", "nominal"], []),
        (["hinf", "nominal"], []),
    ],
)
def test_the_laws_that_were_asked_for_meet_each_other(laws: list[str], pairs: list[tuple[str, str]]) -> None:
    tests = paired(cells(**{law: LOW + k for k, law in enumerate(laws)}))
    assert [(duel.one, duel.other) for duel in duels(tests)] == pairs
    assert bool(against(tests)) == bool(pairs)
    assert MOST_LAWS == 3


def test_laws_without_values_of_both_have_no_test() -> None:
    (duel,) = duels(paired(cells(mine=LOW, paper=np.full(30, np.nan))))
    assert (duel.tests, duel.better, duel.uncertain) == ([], 0, 0)
    assert len(rows(duel, TITLES)) == 1


def test_the_table_of_tests_has_the_differences(tmp_path: Path) -> None:
    found = hg.compare("paper7", ["minimax", "notch"], ["white"], range(3), steps=20, out=tmp_path / "c")
    (duel,) = found.duels
    assert (duel.one, duel.other) == ("minimax", "notch")
    heading = (tmp_path / "c" / "tests.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert heading[-3:] == ["difference", "wins", "losses"]
    assert len(str(found).splitlines()) > len(duel.tests)
