"""The figure of a comparison: a panel per metric, a place per law, a colour per disturbance; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hedgerow.orchestrator.experiments.compare.runs import METRICS
from hedgerow.orchestrator.experiments.compare.statistics import Cell
from hedgerow.orchestrator.report.style import colour, look, save, sheet

LABELS = {
    "share_right": "nodes right [1]",
    "error": r"$|\hat{a} - a|$ [1]",
    "regret": "$D$ [units of $x^2$]",
    "cost_regret": "$R$ [units of $x^2$]",
    "gain": "gain [1]",
    "switches": "switches per node",
}
PANEL_IN = 1.25
_DECADES = 100.0


def draw(cells: Sequence[Cell]) -> Figure:
    """Draw the mean of every cell and its interval over seeds."""
    disturbances = list(dict.fromkeys(cell.disturbance for cell in cells))
    laws = list(dict.fromkeys(cell.law for cell in cells))
    figure = sheet(PANEL_IN * len(METRICS) + 1.2)
    axes = figure.subplots(len(METRICS), sharex=True)
    for axis, metric in zip(axes, METRICS, strict=True):
        shown = []
        for d, disturbance in enumerate(disturbances):
            own = [cell for cell in cells if (cell.disturbance, cell.metric) == (disturbance, metric)]
            place = np.array([laws.index(cell.law) for cell in own]) + 0.6 * ((d + 0.5) / len(disturbances) - 0.5)
            mean, half = (np.array([getattr(cell, name) for cell in own]) for name in ("mean", "half"))
            bars = axis.errorbar(
                place, mean, np.nan_to_num(half), fmt="o", markersize=2.5, linewidth=0.8, color=colour(d)
            )
            bars.set_label(disturbance)
            shown.append(mean[np.isfinite(mean)])
        values = np.concatenate(shown) if shown else np.empty(0)
        if metric in ("regret", "gain") and len(values) and values.max() > _DECADES * max(values.min(), 0) > 0:
            axis.set_yscale("log")
        axis.set_ylabel(LABELS[metric])
    axes[0].set_ylim(-0.03, 1.03)
    axes[0].legend(fontsize=5, ncols=min(3, len(disturbances)))
    axes[-1].set_xticks(range(len(laws)), laws, rotation=90)
    axes[-1].set_xlim(-0.6, len(laws) - 0.4)
    return figure


def write(folder: Path, cells: Sequence[Cell], title: str) -> None:
    """Write compare.pdf and compare.png."""
    with look():
        save(draw(cells), folder, "compare", title)
