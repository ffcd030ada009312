"""The missing parts of a run over time: messages, edges, inputs, and jumps of a, by link and node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hedgerow.orchestrator.ground.colours import BLUE, ORANGE, RED
from hedgerow.orchestrator.report.curves import Entries, bins, called, legend, plain, short, steps_axis
from hedgerow.orchestrator.report.style import ink, sheet
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.graph import Mask

ROWS = 24
"""the maximum number of links and nodes with a row; more are counted instead"""
_COLOUR = {"message lost": ORANGE, "no flow": RED, "no input": BLUE}
_JUMP = "a jumps"


@dataclass(frozen=True)
class Row:
    """A link or a node, with the steps of its missing parts, (T,) each, and the jumps of its a."""

    name: str
    missing: dict[str, Mask]
    jumps: tuple[int, ...] = ()


def rows(run: Run) -> list[Row]:
    """Return the links and nodes with missing parts, in the order of the file."""
    ids = [short(str(node)) for node in run.ids]
    known = ~np.isnan(run.w).any(axis=1)
    found = []
    for k, (i, j) in enumerate(run.edges.tolist()):
        lost = {
            "message lost": known & ~(run.i_hears[:, k] & run.j_hears[:, k]),
            "no flow": known & ~run.edge_open[:, k],
        }
        if any(mask.any() for mask in lost.values()):
            found.append(Row(f"{ids[i]}–{ids[j]}", lost))
    jumps = jumps_of(run)
    for i, name in enumerate(ids):
        silent = known & np.isnan(run.u[:, i])
        if silent.any() or i in jumps:
            found.append(Row(name, {"no input": silent}, jumps.get(i, ())))
    return found


def jumps_of(run: Run) -> dict[int, tuple[int, ...]]:
    """Return the steps of a node's jumps, by its place."""
    turned = (run.a[1:] != run.a[:-1]) & np.isfinite(run.a[1:] + run.a[:-1])
    return {int(i): tuple((turned[:, i].nonzero()[0] + 1).tolist()) for i in turned.any(axis=0).nonzero()[0]}


def has_faults(runs: Sequence[Run]) -> bool:
    """Return True if one of the runs has a missing part or a jump."""
    return any(rows(run) for run in runs)


def draw_faults(runs: Sequence[Run]) -> Figure:
    """Draw the missing parts over time: one panel per run, one row per link or node."""
    listed = [rows(run) for run in runs]
    heights = [min(max(1, len(one)), ROWS if len(one) <= ROWS else 10) for one in listed]
    figure = sheet(0.55 + 0.15 * sum(heights) + 0.25 * len(runs))
    axes = figure.subplots(len(runs), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    shown: dict[str, Artist] = {}
    for k, (axis, run, own) in enumerate(zip(axes, runs, listed, strict=True)):
        shown |= _bars(axis, own) if len(own) <= ROWS else _counts(axis, own)
        if len(runs) > 1:
            axis.set_title(called(k, run) + ("" if own else ": nothing was missing"))
    steps_axis(axes[-1], runs)
    if shown:
        legend(figure, Entries([*shown.values()], [*shown]))
    return figure


def _bars(axis: Axes, listed: Sequence[Row]) -> dict[str, Artist]:
    """Draw one row each; lost messages are above missing flows."""
    shown: dict[str, Artist] = {}
    for place, row in enumerate(listed):
        tall = 0.7 / len(row.missing)
        for part, (what, mask) in enumerate(row.missing.items()):
            if mask.any():
                bars = stretches(mask)
                shown[what] = axis.broken_barh(bars, (place - 0.35 + part * tall, tall), color=_COLOUR[what], lw=0)
        if row.jumps:
            at = np.full(len(row.jumps), place)
            shown[_JUMP] = axis.plot(row.jumps, at, ls="", marker="D", ms=3, color=ink(), clip_on=False)[0]
    axis.set_yticks(range(len(listed)), [plain(row.name) for row in listed])
    axis.set_ylim(max(1, len(listed)) - 0.5, -0.5)
    axis.set_ylabel("link, node" if len(listed) > 2 else "")
    axis.grid(visible=False)
    return shown


def stretches(mask: Mask) -> list[tuple[float, float]]:
    """Return the stretches of a mask, as (first step, number of steps); in a long run, the bins with such a step."""
    parts = bins(len(mask))
    starts = np.array([part[0] for part in parts])
    ends = np.append(starts, len(mask))
    held = np.concatenate([[False], np.logical_or.reduceat(mask, starts), [False]])
    first, last = (held[1:] & ~held[:-1]).nonzero()[0], (held[:-1] & ~held[1:]).nonzero()[0]
    return [(float(ends[i]), float(ends[j] - ends[i])) for i, j in zip(first, last, strict=True)]


def _counts(axis: Axes, listed: Sequence[Row]) -> dict[str, Artist]:
    """Draw the number of links and nodes with missing parts, by step; the maximum of each bin of a long run."""
    shown: dict[str, Artist] = {}
    for what, colour in _COLOUR.items():
        masks = [row.missing[what] for row in listed if what in row.missing]
        if not masks or not any(mask.any() for mask in masks):
            continue
        number = np.sum(masks, axis=0)
        starts = np.array([part[0] for part in bins(len(number))])
        most = np.maximum.reduceat(number, starts)
        shown[what] = axis.step(starts, most, where="post", color=colour)[0]
    if jumps := [step for row in listed for step in row.jumps]:
        shown[_JUMP] = axis.plot(jumps, [0] * len(jumps), ls="", marker="D", ms=3, color=ink(), clip_on=False)[0]
    axis.yaxis.set_major_locator(MaxNLocator("auto", integer=True))
    axis.set_ylabel("links, nodes [count]")
    axis.set_ylim(bottom=0)
    return shown
