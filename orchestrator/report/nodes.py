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
from hedgerow.orchestrator.report.style import PAGE_IN, label_panels, sheet
from hedgerow.orchestrator.runs.run import Run

Runs = Sequence[Run]
_STATE, _ORACLE = "$x_i(t)$ [units of $x$]", r"$x_i^*\!(t)$ [units of $x$]"
_REGRET, _GAP = (
    r"$|x_i(t) - x_i^*\!(t)|$ [units of $x$]",
    r"$|x_i^*\!(t) - x_i^{\mathrm{nom}}(t)|$ [units of $x$]",
)


def states(runs: Runs) -> Figure:
    """Draw figure 2: x, on the axes of figure 3."""
    return _panels(runs, "x", _STATE, _limits(runs, "x", "x_oracle"), behind="x_oracle")


def oracle(runs: Runs) -> Figure:
    """Draw figure 3: x*, on the axes of figure 2."""
    return _panels(runs, "x_oracle", _ORACLE, _limits(runs, "x", "x_oracle"))


def regret(runs: Runs) -> Figure:
    """Draw figure 4: |x - x*|, on the axes of figure 5."""
    return _panels(runs, "regret", _REGRET, _limits(runs, "regret", "nominal_gap"))


def nominal(runs: Runs) -> Figure:
    """Draw figure 5: |x* - x^nom|, on the axes of figure 4."""
    return _panels(runs, "nominal_gap", _GAP, _limits(runs, "regret", "nominal_gap"))


def paper(runs: Runs) -> Figure:
    """Draw figures 2 to 5 of one run as the panels (a) to (d) of a figure as wide as a page, with one legend."""
    (run,) = runs
    figure = sheet(4.2, PAGE_IN)
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    panels = (
        ("x", _STATE, "x_oracle"),
        ("x_oracle", _ORACLE, ""),
        ("regret", _REGRET, ""),
        ("nominal_gap", _GAP, ""),
    )
    for axis, (name, label, behind) in zip(axes.flat, panels, strict=True):
        entries = draw_nodes(axis, run, getattr(run, name))
        if behind and (grey := draw_behind(axis, run, getattr(run, behind))) is not None:
            first = Entries([*entries.handles, grey], [*entries.names, "oracle"])
        elif name == "x":
            first = entries
        zoom(axis, run, getattr(run, name))
        axis.set_ylabel(label)
    for row, names in zip(axes, (("x", "x_oracle"), ("regret", "nominal_gap")), strict=True):
        row[0].set_ylim(*_limits(runs, *names))
    for axis in axes[-1]:
        steps_axis(axis, runs)
    label_panels(axes.flat)
    legend(figure, first)
    return figure


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
    parts = []
    for k, run in enumerate(runs):
        values = getattr(run, name)
        t, i = np.unravel_index(np.nanargmax(values), values.shape)
        where = f"{values[t, i]:.3g}" + (f" (node {run.ids[i]}, step {t})" if values[t, i] else "")
        parts.append(f"{letter(k)} {where}" if len(runs) > 1 else where)
    return f" Largest: {', '.join(parts)}."
