"""Box plots of a sweep, a box a setting; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from orchestrator.report.style import BLUE, GREY, look, save, sheet
from orchestrator.sweep.plan import Plan
from orchestrator.sweep.runs import Row
from orchestrator.sweep.summary import values_of, varied
from topologies.graph import Array

FIGURES = {
    "share_right": "share of nodes right [1]",
    "regret": "$D$ [units of $x^2$]",
    "cost_regret": "$R$ [units of $x^2$]",
    "gain": "gain [1]",
}
"""By metric: its axis."""
FEW, LONG = 8, 12
"""More boxes, or longer names, and the names stand upright."""
_DECADES = 100.0


def draw(plan: Plan, rows: Sequence[Sequence[Row]], metric: str) -> Figure:
    """The boxes of a metric: quartiles, median, and whiskers to 5 and 95 %."""
    places = varied(plan)
    values = [values_of(own, metric) for own in rows]
    names = [[setting.values[k] for k in places] for setting in plan.settings]
    upright = len(names) > FEW or any(len(value) > LONG for name in names for value in name)
    figure = sheet(3.2 if upright else 2.2)
    axis = figure.subplots()
    drawn = axis.boxplot(
        values,
        tick_labels=[(", " if upright else "\n").join(name) or plan.name for name in names],
        whis=(5, 95),
        showfliers=False,
        widths=0.5,
    )
    for line in (*drawn["boxes"], *drawn["whiskers"], *drawn["caps"]):
        line.set(color=GREY, linestyle="-", linewidth=0.8)
    for line in drawn["medians"]:
        line.set(color=BLUE, linestyle="-", linewidth=1.5)
    if upright:
        axis.tick_params(axis="x", labelrotation=90)
    axis.set_xlim(0.4, len(names) + 0.6)
    axis.set_xlabel(", ".join(plan.keys[k] for k in places))
    axis.set_ylabel(FIGURES[metric])
    if metric == "share_right":
        axis.set_ylim(-0.03, 1.03)
    elif _wide(values):
        axis.set_yscale("log")
    return figure


def _wide(values: Sequence[Array]) -> bool:
    """Whether they are all positive, and lie so far apart that the small ones would be flat."""
    low, high = (np.array([np.quantile(own, q) for own in values if len(own)]) for q in (0.05, 0.95))
    return len(low) > 0 and bool(low.min() > 0 and high.max() / low.min() > _DECADES)


def write(folder: Path, plan: Plan, rows: Sequence[Sequence[Row]]) -> list[str]:
    """Draw every figure that has something to show, as PDF and PNG; their names."""
    with look():
        metrics = [metric for metric in FIGURES if any(len(values_of(own, metric)) for own in rows)]
        for metric in metrics:
            save(draw(plan, rows, metric), folder, metric, f"{plan.name}: {metric}")
    return metrics
