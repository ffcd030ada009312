"""The reduction of many nodes and steps for a figure: one line per node for small networks, quantiles or bins for large
ones.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from matplotlib.ticker import MaxNLocator

from hedgerow.orchestrator.ground.colours import GREY, SKY
from hedgerow.orchestrator.report.style import ink
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.graph import Array, Index

NODES = 12
"""the maximum number of nodes for single lines; larger networks are drawn as quantiles"""
STEPS = 1000
"""the maximum number of steps for single points; longer runs are drawn in bins of steps"""
BINS = 500
UNSHOWN = 1e150
"""larger values are left out: their squares overflow"""
_NAME = 16
"""the maximum length of a name in a legend"""
_LINE = 66
"""the maximum length of a line in a legend, of which each handle takes _HANDLE"""
_HANDLE = 5


class Entries(NamedTuple):
    """The content of a legend: handles, and their names."""

    handles: Sequence[Artist]
    names: Sequence[str]


def bins(rows: int) -> list[Index]:
    """Return the rows of each drawn point: one each, or the bins of a long run."""
    return np.array_split(np.arange(rows), BINS if rows > STEPS else rows)


def thin(values: Array) -> tuple[Index, Array]:
    """Return a series over its steps: all of it, or the minimum and the maximum of each bin, in order."""
    t = np.arange(len(values))
    if len(t) <= STEPS:
        return t, values
    rows: list[int] = []
    for part in bins(len(t)):
        known = part[np.isfinite(values[part])]
        ends = {known[values[known].argmin()], known[values[known].argmax()]} if len(known) else {part[0]}
        rows += sorted(map(int, ends))
    return t[rows], values[rows]


def highest(values: Array) -> tuple[Index, Array]:
    """Return a series over its steps: all of it, or the maximum of each bin, at its step."""
    parts = bins(len(values))
    filled = np.where(np.isfinite(values), values, -np.inf)
    rows = [int(part[filled[part].argmax()]) for part in parts]
    return np.array(rows), values[rows]


def extremes(*shown: Array | float) -> tuple[float, float]:
    """Return the minimum and the maximum that an axis can show; an unstable network has larger values."""
    known = [some for one in shown if len(some := (values := np.atleast_1d(one))[np.abs(values) < UNSHOWN])]
    return min((float(one.min()) for one in known), default=0.0), max((float(one.max()) for one in known), default=0.0)


def stairs(axis: Axes, values: Array, **style: Any) -> StepPatch:
    """Draw a series with values that hold until the next step, the last one too."""
    t, shown = thin(values)
    return axis.stairs(shown, np.append(t, len(values)), baseline=None, **style)


def quantiles(values: Array, at: Sequence[float]) -> tuple[Index, Array]:
    """Return quantiles over the nodes and over the steps of each bin, (S,) and (len(at), S); NaN without data."""
    parts, found = bins(len(values)), []
    for part in parts:
        known = values[part][np.isfinite(values[part])]
        found.append(np.quantile(known, at) if len(known) else np.full(len(at), np.nan))
    return np.array([part[0] for part in parts]), np.array(found).T


def draw_nodes(axis: Axes, run: Run, values: Array) -> Entries:
    """Draw curves of all nodes, (S, n): one line each, or quantiles for many nodes or for many steps with both
    signs.
    """
    if not as_quantiles(run, values):
        lines = [axis.plot(*highest(of_node))[0] for of_node in values.T]
        return Entries(lines, ["node " * (k == 0) + plain(short(str(node))) for k, node in enumerate(run.ids)])
    t, (least, low, median, high, most) = quantiles(values, (0, 0.1, 0.5, 0.9, 1))
    bands = [
        axis.plot(t, median, color=ink())[0],
        axis.fill_between(t, low, high, color=SKY, lw=0, alpha=0.8),
        axis.fill_between(t, least, most, color=SKY, lw=0, alpha=0.3, zorder=0.5),
    ]
    return Entries(bands, ["median", "10 to 90 %", f"least to largest of {len(run.ids)} nodes"])


def draw_behind(axis: Axes, run: Run, values: Array) -> Artist | None:
    """Draw the curves of all nodes, (S, n), in grey behind the others; None if there are too many for a line each."""
    if as_quantiles(run, values):
        return None
    lines = [axis.plot(*highest(of_node), color=GREY, ls="-", lw=0.6, alpha=0.6, zorder=1.5)[0] for of_node in values.T]
    return lines[0] if lines else None


DWARFED = 5.0
"""an inset shows the later values if the first ones are larger by this ratio"""


def zoom(axis: Axes, run: Run, values: Array) -> None:
    """Add an inset with the last three quarters of the steps if the first values, (S, n), dwarf them."""
    start = len(values) // 4
    low, high = extremes(values[start:])
    if start < 2 or as_quantiles(run, values) or not 0 < DWARFED * max(-low, high) < np.nanmax(np.abs(values)):
        return
    inset = axis.inset_axes((0.42, 0.42, 0.58, 0.52))
    for of_node in values.T:
        t, shown = highest(of_node)
        inset.plot(t, shown, lw=0.8)
    room = 0.06 * (high - low)
    inset.set_xlim(start, len(values) - 1)
    inset.set_ylim(0.0 if low >= 0 else low - room, high + room)
    inset.tick_params(labelsize=6)
    inset.grid(visible=False)


def as_quantiles(run: Run, values: Array) -> bool:
    """Return True if there are too many nodes for lines, or too many steps for lines with both signs."""
    return len(run.ids) > NODES or (len(values) > STEPS and bool(np.nanmin(values) < 0))


def legend(figure: Figure, entries: Entries) -> None:
    """Draw a legend above all axes, in as few lines as the names allow."""
    names = entries.names
    fitting = [columns for columns in range(1, len(names) + 1) if _length(names, columns) <= _LINE]
    figure.legend(*entries, loc="outside upper center", ncols=max(fitting, default=1))


def _length(names: Sequence[str], columns: int) -> int:
    """Return the width of a legend in characters; it is filled column by column."""
    parts = np.array_split([len(re.sub(r"\\\w+|[${}^]", "", name)) for name in names], columns)
    return sum(_HANDLE + int(part.max()) for part in parts)


def short(name: str) -> str:
    """Return a name, without its middle if it is too long for a legend."""
    half = _NAME // 2
    return name if len(name) <= _NAME else f"{name[:half]}…{name[1 - half :]}"


def plain(text: str) -> str:
    """Return a text with every mathematical sign escaped."""
    return text.replace("$", r"\$")


def steps_axis(axis: Axes, runs: Sequence[Run]) -> None:
    """Set the axis of time, from step 0 to the last."""
    axis.set_xlim(0, max(run.T for run in runs))
    axis.set_xlabel("step $t$")
    axis.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))


def letter(place: int) -> str:
    """Return the letter of a run in a comparison."""
    return chr(ord("A") + place)


def law(run: Run) -> str:
    """Return the name of a run's law, without its module."""
    return plain(run.law.rpartition(":")[2])


def called(place: int, run: Run) -> str:
    """Return the name of a run in the legend of a comparison."""
    return f"{letter(place)}: {law(run)}"
