"""The figure of a comparison: short names of laws, panel letters, and one legend."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.experiments.compare.figure import draw, kinds, short, whiskers
from hedgerow.orchestrator.experiments.compare.runs import METRICS
from hedgerow.orchestrator.experiments.compare.statistics import Cell
from hedgerow.orchestrator.report.style import PAGE_IN, look


def test_a_law_loses_its_module_unless_two_become_equal() -> None:
    assert short(["minimax", "mine:Steady(h=0.5)", "a.b:Slow"]) == ["minimax", "Steady(h=0.5)", "Slow"]
    assert short(["one:Law", "two:Law"]) == ["one:Law", "two:Law"]


def test_the_figure_has_a_panel_per_metric_and_one_legend() -> None:
    values = np.array([0.5, 1.0])
    cells = [Cell(d, law, m, values) for d in ("white", "constant") for law in ("minimax", "x:Law") for m in METRICS]
    with look():
        figure = draw(cells)
    assert figure.get_figwidth() == PAGE_IN
    assert [axis.get_title("left") for axis in figure.axes] == [f"({letter})" for letter in "abcdef"[: len(METRICS)]]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["minimax", "Law"]
    assert len(figure.legends) == 1
    assert [axis.get_legend() for axis in figure.axes] == [None] * len(METRICS)


def test_a_disturbance_of_a_file_has_the_label_of_its_kinds() -> None:
    assert kinds(["white+{kind: impulse, at: 20}", '[{"value": 1, "kind": "ar1"}, {kind: white}]', "confuse"]) == [
        "white+impulse",
        "ar1+white",
        "confuse",
    ]
    twice = ["{kind: white, std: 0.1}", "{kind: white, std: 0.2}"]
    assert kinds(twice) == twice


@given(st.sampled_from(METRICS), st.floats(0, 1), st.one_of(st.floats(0, 1e6), st.just(np.nan)))
def test_no_interval_leaves_the_range_of_its_metric(metric: str, mean: float, half: float) -> None:
    below, above = whiskers(metric, np.array([mean]), np.array([half]))
    assert 0 <= below[0] <= np.nan_to_num(half)
    assert 0 <= above[0] <= np.nan_to_num(half)
    assert metric == "cost_regret" or below[0] <= mean
    assert metric != "share_right" or mean + above[0] <= 1 + 1e-15
