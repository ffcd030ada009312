"""Box plots of a sweep: one box per setting, one panel per metric; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hedgerow.orchestrator.experiments.sweep.plan import Plan
from hedgerow.orchestrator.experiments.sweep.runs import Row
from hedgerow.orchestrator.experiments.sweep.summary import values_of, varied
from hedgerow.orchestrator.ground.colours import BLUE, GREY
from hedgerow.orchestrator.report.style import label_panels, look, save, sheet
from hedgerow.topologies.graph import Array

PANELS = {
    "share_right": "nodes right [1]",
    "regret": "$D$ [units of $x^2$]",
    "cost_regret": "$R$ [units of $x^2$]",
    "gain": "gain [1]",
}
"""By metric: the title of its axis."""
PANEL_IN = 1.4
FEW, LONG = 8, 12
"""With more boxes or longer names, the names are vertical."""
_DECADES = 100.0


def draw(plan: Plan, rows: Sequence[Sequence[Row]]) -> Figure:
    """Return the boxes of every metric: quartiles, median, and whiskers to 5 and 95 %; `rows` are the runs of each
    setting.
    """
    places = varied(plan)
    names = [[setting.values[k] for k in places] for setting in plan.settings]
    upright = len(names) > FEW or any(len(value) > LONG for name in names for value in name)
    figure = sheet(PANEL_IN * len(PANELS) + (1.2 if upright else 0.3))
    axes = figure.subplots(len(PANELS), sharex=True)
    for axis, (metric, label) in zip(axes, PANELS.items(), strict=True):
        _boxes(axis, [values_of(own, metric) for own in rows])
        axis.set_ylabel(label)
    axes[0].set_ylim(-0.03, 1.03)
    axes[0].set_yscale("linear")
    label_panels(axes)
    figure.align_ylabels(axes)
    last = axes[-1]
    last.set_xticks(
        range(1, len(names) + 1), [(", " if upright else "\n").join(name) or plan.name for name in names],
        rotation=90 if upright else 0,
    )  # fmt: skip
    last.set_xlim(0.4, len(names) + 0.6)
    last.set_xlabel(", ".join(plan.keys[k] for k in places))
    return figure


def _boxes(axis: Axes, values: Sequence[Array]) -> None:
    drawn = axis.boxplot(values, whis=(5, 95), showfliers=False, widths=0.5)
    for line in (*drawn["boxes"], *drawn["whiskers"], *drawn["caps"]):
        line.set(color=GREY, linestyle="-", linewidth=0.8)
    for line in drawn["medians"]:
        line.set(color=BLUE, linestyle="-", linewidth=1.5)
    if _wide(values):
        axis.set_yscale("log")


def _wide(values: Sequence[Array]) -> bool:
    """Return True if all values are positive and so different that a linear axis would hide the small ones."""
    low, high = (np.array([np.quantile(own, q) for own in values if len(own)]) for q in (0.05, 0.95))
    return len(low) > 0 and bool(low.min() > 0 and high.max() / low.min() > _DECADES)


def write(folder: Path, plan: Plan, rows: Sequence[Sequence[Row]]) -> None:
    """Write boxes.pdf and boxes.png."""
    with look():
        save(draw(plan, rows), folder, "boxes", f"{plan.name}: {plan.runs} runs")
