"""Estimates against the truth: node by node in a small network, otherwise the share of right ones and their errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hedgerow.orchestrator.ground.colours import BLUE, GREY, ORANGE, PINK
from hedgerow.orchestrator.report.curves import NODES, Entries, bins, legend, plain, short, stairs, steps_axis
from hedgerow.orchestrator.report.style import sheet
from hedgerow.orchestrator.report.timeline import stretches
from hedgerow.orchestrator.report.totals import Series, draw_series
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.graph import Array

_ROWS = 250
"""the maximum number of rows of a heat map"""


def has_estimates(runs: Sequence[Run]) -> bool:
    """Return True if the law of any run reports estimates."""
    return any(np.isfinite(run.ahat).any() for run in runs)


def draw_estimates(runs: Sequence[Run]) -> Figure:
    """Draw the estimate of each node of one small network; otherwise shares of nodes and, for one network, a heat
    map.
    """
    if len(runs) > 1:
        figure = sheet(2.1)
        _shares(figure.subplots(), runs, figure)
    elif len(runs[0].ids) <= NODES:
        figure = _by_node(runs[0])
    else:
        figure = sheet(3.4)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        _shares(upper, runs, figure)
        upper.set_xlabel("")
        _errors(lower, runs[0], figure)
    return figure


def _by_node(run: Run) -> Figure:
    """Draw a small panel per node, two beside each other."""
    n = len(run.ids)
    figure = sheet(0.55 + 0.62 * -(-n // 2))
    axes = figure.subplots(-(-n // 2), 2, sharex=True, sharey=True, squeeze=False).ravel()
    shown: dict[str, Artist] = {}
    for i, (axis, node) in enumerate(zip(axes, run.ids, strict=False)):
        for value in run.candidates[i][np.isfinite(run.candidates[i])]:
            shown["candidates"] = axis.axhline(value, color=GREY, lw=0.4, alpha=0.6)
        shown["truth $a_i$"] = stairs(axis, run.a[:, i], color=ORANGE, lw=2.6, alpha=0.8)
        shown[r"estimate $\hat a_i$"] = stairs(axis, run.ahat[:, i], color=BLUE, lw=1)
        _mark_wrong(axis, run, i, shown)
        axis.set_title(f"node {plain(short(str(node)))}")
        axis.grid(visible=False)
        axis.set_ylim(0, 1)
        steps_axis(axis, [run])
        axis.set_xlabel("")
    for axis in axes[n:]:
        axis.set_visible(False)
    axes[max(0, n - 2)].tick_params(labelbottom=True)
    figure.supxlabel("step $t$", fontsize="medium")
    figure.supylabel(r"$\hat a_i,\ a_i$ [1]", fontsize="medium")
    legend(figure, Entries([*shown.values()], [*shown]))
    return figure


def _mark_wrong(axis: Axes, run: Run, i: int, shown: dict[str, Artist]) -> None:
    """Mark wrong estimates by a bar below, because the error may be too small to see; write the final error."""
    off = run.ahat[:, i] - run.a[:, i]
    wrong = run.wrong[:, i]
    if wrong.any():
        bars = axis.broken_barh(stretches(wrong), (0, 0.09), color=PINK, lw=0, zorder=3)
        shown["wrong"] = bars
    if wrong[-1]:
        axis.set_title(f"ends off by {off[-1]:+.2g}".replace("-", "−"), loc="right", fontsize="small")


SHARES = (
    Series("", lambda run: np.where(run.right < 0, np.nan, run.right / len(run.ids)), BLUE, holds=True),
    Series("by chance", lambda run: float(np.mean(1 / np.isfinite(run.candidates).sum(axis=1))), GREY, ":"),
)


def _shares(axis: Axes, runs: Sequence[Run], figure: Figure) -> None:
    """Draw the share of nodes with a right estimate, and the share that a random choice from the lists would give."""
    legend(figure, draw_series(axis, runs, SHARES))
    # Start a little below 0: a share of 0 would lie under the axis.
    axis.set_ylim(-0.03, 1.03)
    axis.set_ylabel("estimates right\n[share of nodes]")
    steps_axis(axis, runs)


def _errors(axis: Axes, run: Run, figure: Figure) -> None:
    """Draw a heat map of the error, nodes by steps; a cell is the mean over its nodes and steps."""
    error, n = blocks(np.abs(run.ahat - run.a), _ROWS), len(run.ids)
    image = axis.imshow(
        error, cmap="Blues", vmin=0, aspect="auto", interpolation="nearest", extent=(0, run.T, n - 0.5, -0.5)
    )
    axis.set_ylabel("node [place in the file]")
    axis.grid(visible=False)
    steps_axis(axis, [run])
    figure.colorbar(image, ax=axis, label=r"$|\hat a_i - a_i|$ [1]", pad=0.01)


def blocks(values: Array, most: int) -> Array:
    """Return means over bins of steps and over neighbours in the file, at most `most` rows; values: (T, n), blocks: (m,
    S).
    """
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    by_step = [part[0] for part in bins(len(values))]
    by_node = [part[0] for part in np.array_split(np.arange(values.shape[1]), min(most, values.shape[1]))]

    def sums(of: Array) -> Array:
        return np.asarray(np.add.reduceat(np.add.reduceat(of, by_step, axis=0), by_node, axis=1).T)

    with np.errstate(invalid="ignore"):
        return sums(filled) / sums(known.astype(float))
