"""Figures with one curve per node: the paper's 2 to 5, one panel per run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hedgerow.orchestrator.report.curves import (
    Entries,
    called,
    draw_behind,
    draw_nodes,
    extremes,
    legend,
    letter,
    steps_axis,
    zoom,
)
from hedgerow.orchestrator.report.style import sheet
from hedgerow.orchestrator.runs.run import Run

Runs = Sequence[Run]


def states(runs: Runs) -> Figure:
    """Draw figure 2: x, on the axes of figure 3."""
    return _panels(runs, "x", "$x_i(t)$ [units of $x$]", _limits(runs, "x", "x_oracle"), behind="x_oracle")


def oracle(runs: Runs) -> Figure:
    """Draw figure 3: x*, on the axes of figure 2."""
    return _panels(runs, "x_oracle", r"$x_i^*\!(t)$ [units of $x$]", _limits(runs, "x", "x_oracle"))


def regret(runs: Runs) -> Figure:
    """Draw figure 4: |x - x*|, on the axes of figure 5."""
    label = r"$|x_i(t) - x_i^*\!(t)|$ [units of $x$]"
    return _panels(runs, "regret", label, _limits(runs, "regret", "nominal_gap"))


def nominal(runs: Runs) -> Figure:
    """Draw figure 5: |x* - x^nom|, on the axes of figure 4."""
    label = r"$|x_i^*\!(t) - x_i^{\mathrm{nom}}(t)|$ [units of $x$]"
    return _panels(runs, "nominal_gap", label, _limits(runs, "regret", "nominal_gap"))


def _panels(runs: Runs, name: str, label: str, limits: tuple[float, float], behind: str = "") -> Figure:
    """Return a panel per run with an array of every node, before the array `behind` in grey."""
    figure = sheet(0.55 + 1.6 * len(runs))
    axes = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    shown = []
    for axis, run in zip(axes, runs, strict=True):
        entries = draw_nodes(axis, run, getattr(run, name))
        if behind and (grey := draw_behind(axis, run, getattr(run, behind))) is not None:
            entries = Entries([*entries.handles, grey], [*entries.names, "oracle"])
        zoom(axis, run, getattr(run, name))
        shown.append(entries)
    alike = all(one.names == shown[0].names for one in shown)
    for k, (axis, run, entries) in enumerate(zip(axes, runs, shown, strict=True)):
        axis.set_ylim(*limits)
        if len(runs) > 1:
            axis.set_title(called(k, run))
        if not alike:
            axis.legend(*entries, loc="lower right", bbox_to_anchor=(1, 1), ncols=8, handlelength=0.8)
    if alike:
        legend(figure, shown[0])
    steps_axis(axes[-1], runs)
    if len(runs) > 1:
        figure.supylabel(label, fontsize="medium")
    else:
        axes[0].set_ylabel(label)
    return figure


def _limits(runs: Runs, *names: str) -> tuple[float, float]:
    """Return limits of an axis with room for some arrays of all runs; from 0 for nonnegative ones."""
    low, high = extremes(*(getattr(run, name) for run in runs for name in names))
    room = 0.04 * (high - low) or 1.0
    return (0.0 if low >= 0 else low - room), high + room


def largest(runs: Runs, name: str) -> str:
    """Return the maximum of an array, with its node and step, in words."""
    said = []
    for k, run in enumerate(runs):
        values = getattr(run, name)
        t, i = np.unravel_index(np.nanargmax(values), values.shape)
        where = f"{values[t, i]:.3g}" + (f" (node {run.ids[i]}, step {t})" if values[t, i] else "")
        said.append(f"{letter(k)} {where}" if len(runs) > 1 else where)
    return f" Largest: {', '.join(said)}."
