"""Figure 1: the network, and the nodes with a wrong estimate at the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hedgerow.orchestrator.ground.colours import BLACK, GREY, PINK
from hedgerow.orchestrator.report.curves import Entries, called, legend, plain, short
from hedgerow.orchestrator.report.style import sheet, width_in
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.layout import placed
from hedgerow.orchestrator.views.palette import thickness
from hedgerow.topologies.graph import Array, Mask

NAMED = 40
"""the maximum number of nodes for names"""
_INSIDE = 3
"""the maximum length of a name inside a node; longer names are below it"""
_MARGIN = 0.6
"""the margin around the network, in lengths of an edge"""


def network(runs: Sequence[Run]) -> Figure:
    """Draw the graph of each run, each with its own layout: the same file gives the same places."""
    places = [placed(run.topology) for run in runs]
    heights = [float(np.clip((width_in() - 0.2) * _aspect(own), 0.7, 3.3)) for own in places]
    figure = sheet(0.3 + sum(heights) + 0.2 * (len(runs) - 1))
    axes = figure.subplots(len(runs), 1, squeeze=False, height_ratios=heights)[:, 0]
    for k, (axis, run, own) in enumerate(zip(axes, runs, places, strict=True)):
        _draw(axis, run, own)
        if len(runs) > 1:
            axis.set_title(called(k, run))
    if any(wrong(run).any() for run in runs):
        mark = Line2D([], [], ls="", marker="o", ms=6, mfc=PINK, mec=BLACK, mew=0.6)
        legend(figure, Entries([mark], ["estimate wrong at the end"]))
    return figure


def wrong(run: Run) -> Mask:
    """Return a mask of the nodes with a wrong last estimate, (n,)."""
    last, truth = run.ahat[-1], run.a[-1]
    return np.asarray(np.isfinite(last) & (last != truth))


def unnamed(runs: Sequence[Run]) -> str:
    """Return a sentence if names are left out."""
    return f" Beyond {NAMED} nodes names are left out." if any(len(run.ids) > NAMED for run in runs) else ""


def _aspect(places: Array) -> float:
    """Return height over width, margins included."""
    width, height = np.ptp(places, axis=0) + 2 * _MARGIN
    return float(height / width)


def _draw(axis: Axes, run: Run, places: Array) -> None:
    n = len(run.ids)
    weights = run.topology.graph.weights
    wide = 0.8 if n <= NAMED else 0.4
    widths: Array | float = wide if weights is None else 3 * wide * thickness(weights, len(weights))
    axis.add_collection(LineCollection([*places[run.edges]], colors=GREY, linewidths=widths, zorder=1))
    size = 170 if n <= NAMED // 2 else 90 if n <= NAMED else max(2.0, 6000 / n)
    faces = np.where(wrong(run), PINK, "#FFFFFF")
    axis.scatter(
        places[:, 0],
        places[:, 1],
        s=size,
        c=faces.tolist(),
        edgecolors=BLACK,
        linewidths=0.6 if n <= NAMED else 0.2,
        zorder=2,
    )
    for k, (x, y) in enumerate(places.tolist()):
        name = plain(short(run.topology.network.name(k)))
        if n <= NAMED and len(name) <= _INSIDE:
            axis.text(x, y, name, ha="center", va="center_baseline", color=BLACK, fontsize="x-small", zorder=3)
        elif n <= NAMED:
            axis.annotate(name, (x, y), (0, -9), textcoords="offset points", ha="center", va="top", fontsize="x-small")
    low, high = places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN
    axis.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal")
    axis.set_axis_off()
