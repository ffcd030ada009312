"""Several runs in one report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hedgerow.orchestrator.report import report
from hedgerow.orchestrator.report.compare import notices
from hedgerow.orchestrator.report.reading import METRICS, number
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.figures import curves, drawn, names, page, ran
from tests.tools.refusals import refusal


def test_two_laws_on_the_same_axes(paper: Run, fixed: Run, folder: Path) -> None:
    """Each run has a panel with the same limits; totals overlap, numbers are side by side, and differences are in
    words.
    """
    upper, lower = drawn("4", paper, fixed).axes
    np.testing.assert_array_equal(np.array(curves(upper)).T, paper.regret)
    np.testing.assert_array_equal(np.array(curves(lower)).T, fixed.regret)
    assert upper.get_ylim() == lower.get_ylim()
    assert [axis.get_title("left") for axis in (upper, lower)] == ["A: minimax", "B: nominal"]
    figure = drawn("regret", paper, fixed)
    expected = [paper.regret_sum, paper.nominal_regret_sum, fixed.regret_sum, fixed.nominal_regret_sum]
    np.testing.assert_array_equal(curves(figure.axes[0]), expected)
    assert names(figure) == ["A: minimax", "B: nominal", "nominal"]

    path, *_ = report([paper, fixed], folder / "laws", "regret,gain", formats=["svg"])
    shown = page(path)
    for name, words in METRICS.items():
        if name != "nodes_right":
            assert shown.row(words) == [number(run.verdict.content["metrics"][name]) for run in (paper, fixed)]
    assert "B differs from A in the law (nominal, not minimax)." in shown.text
    assert not [own for _, own in shown.elements if own.get("class") == "warning"]


def test_other_networks_are_not_compared_without_a_warning(paper: Run, grid: Run, folder: Path) -> None:
    path, *_ = report([paper, grid], folder / "others", "2", formats=["svg"])
    text = " ".join(page(path).text)
    assert "(16, not 7)" in text
    assert [own for _, own in page(path).elements if own.get("class") == "warning"]


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        ([], "B repeats A"),
        (["seed=2"], "B differs from A in true a and candidates and the disturbances. So it has a different oracle"),
        (["faults=[{kind: drop, link: [2, 4], steps: [3, 9]}]"], "B differs from A in the faults."),
        (
            ["steps=20", "defaults.x0=1"],
            "B differs from A in x(0) and the steps (20, not 30). So it has a different oracle",
        ),
        (["b=0.09"], "B is of another network than A: it has other b (0.09, not 0.1)."),
    ],
)
def test_differences_are_reported(paper: Run, tmp_path: Path, overrides: Sequence[str], sentence: str) -> None:
    comparable, sentences = notices([paper, ran(resolve(load("paper7", overrides)), tmp_path / "run")])
    assert sentences[0].startswith(sentence)
    assert comparable == ("another network" not in sentence)


def test_too_many_runs(paper: Run, tmp_path: Path) -> None:
    with refusal(Code.OPTION):
        report([paper] * 8, tmp_path / "out")
