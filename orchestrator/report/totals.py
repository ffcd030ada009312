"""Figures of the whole network: a few series of each run, with all runs on the same axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hedgerow.orchestrator.ground.colours import BLUE, GREY, ORANGE, RED
from hedgerow.orchestrator.report.curves import Entries, called, extremes, law, legend, stairs, steps_axis, thin
from hedgerow.orchestrator.report.style import colour, ink, marker, sheet
from hedgerow.orchestrator.runs.guaranteed import is_recorded
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.graph import Array

Runs = Sequence[Run]


class Series(NamedTuple):
    """One number per step.

    In the figure of one run, series differ by colour and line style. In a comparison, the runs differ by colour and
    marker, and the series of each by line style.
    """

    name: str
    of: Callable[[Run], Array | float]
    """(S,), or a number that is constant"""
    color: str
    style: str = "-"
    holds: bool = False
    """True if a value holds until the next step"""


def draw_series(axis: Axes, runs: Runs, listed: Sequence[Series]) -> Entries:
    """Draw series of all runs; an empty name is replaced by the law of the run."""
    alone = len(runs) == 1
    drawn: list[Artist] = []
    for k, run in enumerate(runs):
        for series in listed:
            line: dict[str, Any] = {"color": series.color if alone else colour(k), "ls": series.style}
            values = series.of(run)
            if isinstance(values, float):
                drawn.append(axis.axhline(values, **line))
            elif series.holds:
                drawn.append(stairs(axis, values, **line, lw=1))
                if not alone:  # a patch of stairs has no markers
                    at = np.array(marked(len(values), k, len(runs)), dtype=int)
                    axis.plot(at + 0.5, values[at], **line | {"ls": ""}, **_mark(k))
            else:
                t, shown = thin(values)
                marks = {} if alone else {"markevery": marked(len(t), k, len(runs)), **_mark(k)}
                drawn += axis.plot(t, shown, **line, **marks)
    if alone:
        return Entries(drawn, [series.name or law(runs[0]) for series in listed])
    named = [called(k, run) for k, run in enumerate(runs)]
    solid = [Line2D([], [], color=colour(k), ls="-", **_mark(k)) for k in range(len(runs))]
    styles = [series for series in listed if series.name]
    return Entries(
        [*solid, *(Line2D([], [], color=ink(), ls=series.style) for series in styles)],
        [*named, *(series.name for series in styles)],
    )


MARKS = 5
"""the number of markers on a line"""


def marked(points: int, place: int, runs: int) -> list[int]:
    """Return the positions of up to MARKS markers on a line; each run of a comparison has its own, so that equal lines
    show all.
    """
    part = (np.arange(MARKS) + (place + 0.5) / runs) / MARKS
    return [int(at) for at in np.unique((part * points).astype(int))]


def _mark(place: int) -> dict[str, Any]:
    return {"marker": marker(place), "ms": 3.5}


def _one(runs: Runs, label: str, listed: Sequence[Series]) -> tuple[Figure, Axes]:
    figure = sheet(2.15)
    axis = figure.subplots()
    entries = draw_series(axis, runs, listed)
    if len(entries.names) > 1:
        legend(figure, entries)
    axis.set_ylabel(label)
    steps_axis(axis, runs)
    return figure, axis


def sums(runs: Runs) -> Figure:
    """Draw D of the run, and of its nominal twin."""
    listed = [Series("", lambda run: run.regret_sum, BLUE), Series("nominal", _nominal_sum, ORANGE, "--")]
    figure, axis = _one(runs, "$D(t)$ [units of $x^2$]", listed)
    axis.set_ylim(0, 1.05 * extremes(*(series.of(run) for run in runs for series in listed))[1] or 1.0)
    return figure


def _nominal_sum(run: Run) -> Array:
    return run.nominal_regret_sum


def cost(runs: Runs) -> Figure:
    """Draw R, with its sign."""
    return _signed(runs, "$R(t)$ [units of $x^2$]", lambda run: run.cost_regret)


def _signed(runs: Runs, label: str, values: Callable[[Run], Array]) -> Figure:
    """Draw one value of each run over time, with the line of zero."""
    figure, axis = _one(runs, label, [Series("", values, BLUE)])
    axis.axhline(0, color=GREY, lw=0.5, zorder=1)
    low, high = extremes(0.0, *map(values, runs))
    room = 0.06 * (high - low) or 1.0
    axis.set_ylim(low - room, high + room)
    return figure


GAINS = (
    Series("gain", lambda run: run.gain, ORANGE, "--"),
    Series(r"$\gamma^*$ (oracle)", lambda run: float(run.gamma_star), GREY, ":"),
    Series("without $V(x(0))$", lambda run: run.gain_less_x0, BLUE),
)
"""The lines of the gain, from the top line to the lowest in most runs: the legend has their order."""

CEILING = Series("at most, from $x(0) = 0$", lambda run: run.ceiling, RED, "-.")


def gain(runs: Runs) -> Figure:
    """Draw the empirical gain, with and without the maximum cost of x(0), with the oracle's number and the law's
    bound.
    """
    figure, axis = _one(runs, "gain [1]", [GAINS[0], CEILING, *GAINS[1:]] if _bounded(runs) else GAINS)
    # Start a little below 0: a gain of 0 without the cost of x(0) would lie under the axis.
    axis.set_ylim(-0.03 * ceiling(runs), ceiling(runs))
    return figure


def has_slack(runs: Runs) -> bool:
    """Return True if a run has a step with a certificate of the law, and its slack."""
    return any(np.isfinite(slack).any() for run in _bounded(runs) if (slack := _slack(run)) is not None)


def slack(runs: Runs) -> Figure:
    """Draw the slack of the certificate of the law."""
    known = [run for run in runs if _slack(run) is not None]
    return _signed(known, "slack [units of $x^2$]", lambda run: run.ceiling_slack)


def _slack(run: Run) -> Array | None:
    """Return the slack of a run; None of an older run with a part of its rows."""
    return run.ceiling_slack if run.whole or is_recorded(run) else None


def _bounded(runs: Runs) -> list[Run]:
    """Return the runs that have a bound on the law's gain."""
    return [run for run in runs if np.isfinite(run.ceiling).any()]


def ceiling(runs: Runs) -> float:
    """Return the upper end of the axis of the gain; the first gains may be above it, because x(0) may be large."""
    shown = [(run.gamma_star, run.gain[-1], run.gain_less_x0) for run in runs]
    top = 2 * extremes(*(one for of_run in shown for one in of_run))[1]
    # A bound far above everything else would squeeze the rest: leave it outside.
    bounds = [float(np.nanmin(run.ceiling)) for run in _bounded(runs)]
    return max([top, *(1.1 * bound for bound in bounds if bound < 2 * top)])


def beyond(runs: Runs) -> str:
    """Return a sentence about the part of the gain above the axis."""
    tops = [(run, float(np.nanmax(run.gain, initial=0))) for run in runs]
    parts = [f"{top:.3g}" for _, top in tops if top > ceiling(runs)]
    return f" The gain begins above the axis, at up to {' and '.join(parts)}." if parts else ""
