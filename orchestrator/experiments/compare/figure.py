"""The figure of a comparison: a panel per metric, a row per law, a colour and a marker per disturbance."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hedgerow.orchestrator.experiments.compare.runs import METRICS
from hedgerow.orchestrator.experiments.compare.statistics import Cell
from hedgerow.orchestrator.experiments.sweep.plan import split
from hedgerow.orchestrator.report.style import PAGE_IN, colour, label_panels, look, save, sheet
from hedgerow.topologies.graph import Array

LABELS = {
    "share_right": "nodes right [1]",
    "error": r"$|\hat{a} - a|$ [1]",
    "regret": "$D$ [units of $x^2$]",
    "cost_regret": "$R$ [units of $x^2$]",
    "gain": "gain [1]",
    "switches": "switches per node",
}
RANGES = {"share_right": (0.0, 1.0), "cost_regret": (-np.inf, np.inf)}
"""the values that a metric can have; the others are at least 0"""
WIDE = frozenset({"regret", "cost_regret", "gain"})
"""the metrics that may differ by orders of magnitude between laws"""
COLUMNS = 3
ROW_IN, AXIS_IN = 0.22, 0.55
MARKERS = "osD^vPX"
_DECADES = 100.0


def short(laws: Sequence[str]) -> list[str]:
    """Return the laws without their modules, where no two become equal."""
    return _unlike(laws, [re.sub(r"^[\w.]+:", "", law) for law in laws])


def kinds(disturbances: Sequence[str]) -> list[str]:
    """Return the disturbances by their kinds, where no two become equal: `white+impulse`."""
    parts = [[re.findall(r"\bkind\W+(\w+)", part) or [part] for part in split(one, "+")] for one in disturbances]
    return _unlike(disturbances, ["+".join(itertools.chain(*own)) for own in parts])


def _unlike(whole: Sequence[str], short: Sequence[str]) -> list[str]:
    return [name if short.count(name) == 1 else one for one, name in zip(whole, short, strict=True)]


def whiskers(metric: str, mean: Array, half: Array) -> Array:
    """Return the parts of an interval below and above the mean, (2, ...), cut off at the range of the metric."""
    least, most = RANGES.get(metric, (0.0, np.inf))
    reach = np.nan_to_num(half)
    parts: Array = np.nan_to_num(np.stack([np.minimum(reach, mean - least), np.minimum(reach, most - mean)]))
    return parts


def draw(cells: Sequence[Cell]) -> Figure:
    """Draw the mean of every cell and its interval over seeds."""
    disturbances = list(dict.fromkeys(cell.disturbance for cell in cells))
    laws = list(dict.fromkeys(cell.law for cell in cells))
    labels = kinds(disturbances)
    rows = -(-len(METRICS) // COLUMNS)
    lines = len(laws) * max(1.0, 0.6 * len(disturbances))
    figure = sheet(rows * (ROW_IN * lines + AXIS_IN) + 0.25, PAGE_IN)
    axes = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).ravel()
    for axis, metric in zip(axes, METRICS, strict=True):
        shown = []
        axis.margins(x=0.06)
        for d, disturbance in enumerate(disturbances):
            own = [cell for cell in cells if (cell.disturbance, cell.metric) == (disturbance, metric)]
            place = np.array([laws.index(cell.law) for cell in own]) + 0.6 * ((d + 0.5) / len(disturbances) - 0.5)
            mean, half = (np.array([getattr(cell, name) for cell in own]) for name in ("mean", "half"))
            bars = axis.errorbar(
                mean,
                place,
                xerr=whiskers(metric, mean, half),
                fmt=MARKERS[d % len(MARKERS)],
                markersize=2.5,
                linewidth=0.8,
                color=colour(d),
            )
            bars.set_label(labels[d])
            shown.append(mean[np.isfinite(mean)])
        values = np.concatenate(shown) if shown else np.empty(0)
        sizes = np.abs(values[values != 0])
        if metric in WIDE and len(sizes) and sizes.max() > _DECADES * sizes.min():
            least = 10 ** np.floor(np.log10(sizes.min()))
            axis.set_xscale("symlog", linthresh=least)
            axis.xaxis.get_major_locator().set_params(numticks=6)
            if metric not in RANGES:
                axis.set_xlim(left=-0.3 * least)
        axis.grid(axis="both")
        axis.set_xlabel(LABELS[metric])
    axes[0].set_xlim(-0.05, 1.05)
    axes[0].set_yticks(range(len(laws)), short(laws))
    axes[0].set_ylim(len(laws) - 0.5, -0.5)
    label_panels(axes)
    if len(disturbances) > 1:
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=min(6, len(disturbances)))
    return figure


def write(folder: Path, cells: Sequence[Cell], title: str) -> None:
    """Write compare.pdf and compare.png."""
    with look():
        save(draw(cells), folder, "compare", title)
