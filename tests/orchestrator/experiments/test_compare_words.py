"""The words of a comparison claim no more than its tests, and runs that a law ended take no part."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import hedgerow as hg
from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.local import Received
from hedgerow.orchestrator.experiments.compare.plan import comparison
from hedgerow.orchestrator.experiments.compare.runs import METRICS, answer
from hedgerow.orchestrator.experiments.compare.statistics import Cell, least_p, paired, pairs_needed
from hedgerow.orchestrator.experiments.compare.tables import findings, shortage
from hedgerow.orchestrator.experiments.sweep.plan import Chunk
from hedgerow.orchestrator.metrics import observer
from hedgerow.topologies.errors import UserError


def cell(law: str, values: Array, metric: str = "regret") -> Cell:
    return Cell("white", law, metric, values)


LOW = np.linspace(1.0, 1.2, 30)


def words(*cells: Cell) -> str:
    (sentence,) = (one for one in findings(cells, paired(cells), "white") if "undefined" not in one)
    return sentence


def test_a_law_that_beats_all_others_is_best() -> None:
    assert "low is best" in words(cell("low", LOW), cell("high", LOW + 5))


def test_a_law_that_ties_with_another_is_not_called_best() -> None:
    noise = np.random.default_rng(1).normal(size=30)
    sentence = words(cell("low", LOW), cell("near", LOW + 1e-3 * noise), cell("high", LOW + 5))
    assert "is best" not in sentence
    assert "better than high" in sentence
    assert "not distinguishable from" in sentence


def test_laws_with_the_same_values_are_equal() -> None:
    assert "is best" not in words(cell("one", LOW), cell("two", LOW))
    assert "equal to two" in words(cell("one", LOW), cell("two", LOW), cell("high", LOW + 5))


def test_the_intervals_and_tests_are_those_of_scipy() -> None:
    draw = np.random.default_rng(2)
    made = [cell(f"law{k}", draw.normal(0.1 * k, 1.0, 25)) for k in range(4)]
    for one in made:
        low, high = stats.t.interval(0.95, 24, one.values.mean(), stats.sem(one.values))
        assert (one.mean - one.half, one.mean + one.half) == pytest.approx((low, high))
    of = {one.law: one.values for one in made}
    for test in paired(made):
        assert test.p == pytest.approx(stats.wilcoxon(of[test.one], of[test.other]).pvalue)


@pytest.mark.parametrize(("laws", "seeds", "needed"), [(2, 5, 6), (2, 6, None), (3, 6, 7), (3, 7, None), (6, 8, 10)])
def test_too_few_seeds_are_those_that_no_outcome_can_decide(laws: int, seeds: int, needed: int | None) -> None:
    """The values are as far apart as they can be: every law is better than the one before, for every seed."""
    made = [cell(f"law{k}", (k + 1.0) * np.arange(1.0, seeds + 1)) for k in range(laws)]
    tests = paired(made)
    assert pairs_needed(tests) == needed
    assert any(test.decided for test in tests) == (needed is None)
    assert min(test.p for test in tests) == least_p(seeds)
    assert bool(shortage(tests)) == (needed is not None)


class Ends(Minimax):
    """Raises after some steps."""

    def act(self, x: Array, now: Received) -> Array:  # type: ignore[override]  # it asks
        if now.t == 20:
            raise ValueError("no")
        return super().act(x)


def test_the_sums_of_a_run_that_its_law_ended_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums over fewer steps would look better."""
    monkeypatch.setattr(observer, "ROWS", 4)
    trees = {"name": "trees", "b": 0.1, "steps": 40, "graph": {"kind": "random_tree", "nodes": 4}}
    plan = comparison({**trees, "defaults": {"candidates": {"random": 3}}}, [f"{__name__}:Ends"], ["white"], range(2))
    rows = answer(plan, Chunk(0, (0, 1)))
    assert isinstance(rows, list)
    for row in rows:
        assert row["verdict"] == "unknown"
        assert all(row[metric] is None for metric in METRICS)
    assert Path(__file__).name in rows[0]["reasons"]


class Half(Minimax):
    """Acts with half the input."""

    def __init__(self, b: float, candidates: Array, *, share: float = 0.5) -> None:
        super().__init__(b, candidates)
        self.share = share

    def act(self, x: Array) -> Array:
        return np.asarray(self.share * super().act(x))


def test_classes_are_compared_as_they_are_simulated(tmp_path: Path) -> None:
    laws: list[Any] = [Half, functools.partial(Half, share=0.25), Minimax]
    found = hg.compare("paper7", laws, ["white"], range(2), steps=5, out=tmp_path / "c")
    half = f"{__name__}:Half"
    assert found.plan.laws == [half, f"{half}(share=0.25)", "minimax", "hinf", "nominal"]
    with pytest.raises(UserError):
        hg.compare("paper7", [3], ["white"], range(2), steps=5)  # type: ignore[list-item]
