"""The content of the Rerun view of a run: its quantities, and their places on the screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.runs.selection import evenly, selection
from hedgerow.orchestrator.views.palette import (
    BACKGROUND,
    BLUE,
    CUT,
    GREY,
    LOST,
    NO_INPUT,
    ORANGE,
    VERMILLION,
    Color,
    hues,
)
from hedgerow.orchestrator.views.rerun.fault_timeline import LANE_ENTITIES, LANES
from hedgerow.orchestrator.views.rerun.network_picture import Legend
from hedgerow.topologies.graph import Index
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import RoundTripTimes

Matrix = NDArray[np.float64]

LEGEND_NODES = 7
"""the maximum number of nodes for a legend: the viewer clips a longer one in a window of 1280 by 800, and the names in
the picture have the colours too
"""
LINES = 10_000
"""the maximum number of nodes or edges with a line"""
LARGE = 24
"""networks with more nodes are shown by quantiles and counts, with the plots of every node in tabs behind"""


@dataclass(frozen=True)
class Quantity:
    """One entity of the recording: k series over the steps, named and coloured once."""

    entity: str
    of: Callable[[Batch], NDArray[Any]]
    """returns the columns of a batch of B steps, (B, k) or (B,)"""
    names: Sequence[str]
    colors: Sequence[Color]
    width: float = 1.5
    steps: bool = False
    """True if the values hold until the next step"""

    def style(self) -> rr.SeriesLines:
        """Return names, colours and widths [points] of the k series."""
        mode = rr.components.InterpolationMode
        return rr.SeriesLines(
            names=self.names,
            colors=self.colors,
            widths=[self.width] * len(self.names),
            interpolation_mode=mode.StepAfter if self.steps else mode.Linear,
        )

    def columns(self, batch: Batch) -> Matrix:
        """Return the series, (B, k); infinite values become NaN, because a plot cannot show them."""
        values = np.asarray(self.of(batch), dtype=np.float64).reshape(len(batch.t), -1)
        return np.where(np.isinf(values), np.nan, values)


def lines(topology: Topology) -> list[Quantity]:
    """Return one line for each node and edge with rows, up to LINES."""
    which, graph = selection(topology), topology.graph
    nodes, flows = lined(which.nodes), lined(which.edges)
    ids = [str(topology.ids[k]) for k in nodes.tolist()]
    edges = [f"{topology.ids[i]}–{topology.ids[j]}" for i, j in graph.edges[flows].tolist()]
    node, pale = hues(len(ids)), hues(len(ids), alpha=140)

    def each(name: str) -> Callable[[Batch], Matrix]:
        return lambda batch: _some(getattr(batch, name), nodes)

    # Equal names share one entry of a legend: with one entry per line, the legend would not fit beside seven nodes.
    listed = [
        Quantity("x", each("x"), ids, node),
        Quantity("x_oracle", each("x_oracle"), ["oracle"] * len(ids), pale, 1.0),
        Quantity("x_nominal", each("x_nominal"), _each(ids, "nominal"), pale, 1.0),
        Quantity("u", each("u"), ids, node, steps=True),
        Quantity("u_edge", lambda batch: _some(batch.u_edge, flows), edges, hues(len(edges)), steps=True),
        Quantity("w", each("w"), ids, node, steps=True),
        Quantity("ahat", each("ahat"), ids, node, 2.0, steps=True),
        Quantity(
            "index", lambda batch: _named(_some(batch.ahat, nodes), _some(batch.index, nodes)), ids, node, steps=True
        ),
        Quantity("truth", each("a"), _each(ids, "truth"), pale, 1.0, steps=True),
        Quantity(
            "error", lambda batch: np.abs(_some(batch.ahat, nodes) - _some(batch.a, nodes)), ids, node, steps=True
        ),
        Quantity("a_ls", each("a_ls"), ids, node),
        Quantity("margin", each("margin"), ids, node),
        Quantity("regret", each("regret"), ids, node),
        Quantity("nominal_gap", each("nominal_gap"), ids, node),
    ]
    return [quantity for quantity in listed if quantity.names]


def lined(some: Index) -> Index:
    """Return the nodes or edges that have a line."""
    return some[evenly(len(some), LINES)]


def totals(topology: Topology, observer: Observer) -> list[Quantity]:
    """Return the quantities of the whole network, with one number or a few each."""
    limit = topology.network.gamma_star_now
    gain = "gain with x(0)" if float(observer.v0) > 0 else "gain"

    def gains(batch: Batch) -> Matrix:
        # From the top line to the lowest in most runs, so that the legend has their order.
        return np.stack([batch.gain(), batch.ceiling, np.full(len(batch.t), limit)], axis=1)

    def sums(batch: Batch) -> Matrix:
        return np.stack([batch.regret_sum, batch.nominal_regret_sum], axis=1)

    return [
        Quantity("nodes_right", lambda batch: batch.right, ["nodes right"], [BLUE], steps=True),
        Quantity("regret_sum", sums, [topology.law, "nominal"], [BLUE, ORANGE], 2.0),
        Quantity("cost_regret", lambda batch: batch.cost_regret, ["R"], [BLUE], 2.0),
        Quantity("cost_ratio", lambda batch: batch.ratio, ["cost / oracle's cost"], [BLUE], 2.0),
        Quantity("gain", gains, [gain, "at most, from x(0) = 0", "γ* (oracle)"], [ORANGE, VERMILLION, GREY], 2.0),
        Quantity("ceiling_slack", lambda batch: batch.ceiling_slack, ["slack"], [VERMILLION], 2.0),
    ]


def _some(values: NDArray[Any], columns: Index) -> NDArray[Any]:
    return values if len(columns) == values.shape[1] else values[:, columns]


def _named(ahat: Matrix, index: NDArray[Any]) -> Matrix:
    """Return the indices of the estimates in the candidate lists, from 0; -1 for other values, and a gap without an
    estimate.
    """
    return np.where(np.isnan(ahat), np.nan, index)


def aggregates(topology: Topology) -> list[Quantity]:
    """Return the quantities of a large network that replace a line per node; they are computed for the viewer only."""
    if len(topology.ids) <= LARGE:
        return []
    names, colors = ["largest", "90 %", "median"], [ORANGE, BLUE, GREY]

    def counts(batch: Batch) -> NDArray[Any]:
        down = (~batch.edge_open, ~batch.link_up, batch.missing)
        return np.stack([which.sum(axis=1) for which in down], axis=1)

    return [
        Quantity("quantiles/x", lambda batch: _quantiles(np.abs(batch.x)), names, colors),
        Quantity("quantiles/regret", lambda batch: _quantiles(batch.regret), names, colors),
        Quantity("quantiles/u", lambda batch: _quantiles(np.abs(np.nan_to_num(batch.u))), names, colors, steps=True),
        Quantity("quantiles/down", counts, list(DOWN), [CUT, LOST, NO_INPUT], 2.0, steps=True),
    ]


ROUND_TRIPS = "round_trip_ms"


class RoundTripLines:
    """The answer times of the processes: one line each or, with many processes, the maximum, the 90 % quantile and the
    median.
    """

    def __init__(self, processes: Sequence[str]) -> None:
        self._many = len(processes) > LARGE
        self.names = ["slowest", "90 %", "median"] if self._many else list(processes)

    def style(self) -> rr.SeriesLines:
        """Return names, colours and widths [points]."""
        colors = [ORANGE, BLUE, GREY] if self._many else hues(len(self.names))
        return rr.SeriesLines(names=self.names, colors=colors, widths=[1.5] * len(self.names))

    def columns(self, latencies: RoundTripTimes) -> Matrix:
        """Return the series [ms], one row per step, NaN without an answer."""
        ms = 1e3 * latencies.seconds
        return _quantiles(np.nan_to_num(ms)) if self._many else ms


DOWN = ("edges cut", "messages lost", "nodes without input")


def _quantiles(values: Matrix) -> Matrix:
    """Return the maximum, the 90 % quantile and the median of each row."""
    n = values.shape[1]
    at = [n - 1, int(0.9 * (n - 1)), (n - 1) // 2]
    return np.asarray(np.partition(values, at, axis=1)[:, at])


def _each(ids: Sequence[str], what: str) -> list[str]:
    return [f"{node} {what}" for node in ids]


def blueprint(topology: Topology, gamma_star: float, legend: Legend, processes: int = 0) -> rrb.Blueprint:
    """Return the layout: the network and its status at the left; six plots, the faults and the events at the right.

    In a run over Zenoh, the answer times of the `processes` are beside the events.
    """
    nodes = len(topology.ids)
    large = nodes > LARGE
    network = rrb.Spatial2DView(
        origin="/network",
        name=f"Network {topology.name}",
        background=list(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=legend.x_range, y_range=legend.y_range),
    )
    words = rrb.Tabs(
        rrb.TextDocumentView(origin="/now", name="Now"),
        rrb.TextDocumentView(origin="/about", name="About this run"),
        active_tab=0,
    )
    summary = rrb.Vertical(network, words, row_shares=[5, 2])
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["loglevel", "body"]),
    )
    title = f"Faults (first {LANES} links and nodes)" if large else "Faults"
    fault_lines = rrb.StateTimelineView(origin="/", contents=LANE_ENTITIES, name=title, time_view=_whole())
    # One process per node has the colour of its node, and a legend would cover the lines.
    named = processes < nodes and processes <= LEGEND_NODES
    latencies = [_plot("Round trips, ms", ROUND_TRIPS, legend="LeftTop" if named else None)]
    if large:
        down = _plot("Down", "quantiles/down", legend="LeftTop")
        first = rrb.Tabs(down, *latencies) if processes else down
        happened = rrb.Horizontal(first, fault_lines, events, column_shares=[2, 3, 2])
    elif processes:
        happened = rrb.Horizontal(*latencies, fault_lines, events, column_shares=[2, 3, 3])
    else:
        happened = rrb.Horizontal(fault_lines, events, column_shares=[3, 2])
    plots = _aggregated(topology, gamma_star) if large else _plots(topology, gamma_star)
    return rrb.Blueprint(
        rrb.Horizontal(summary, rrb.Vertical(plots, happened, row_shares=[2.4, 1]), column_shares=[1, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
    )


def _plots(topology: Topology, gamma_star: float) -> rrb.Grid:
    # The titles fit beside each other in a window of 1280 pixels; About has the units and explains the pale lines.
    legend = "RightTop" if len(topology.ids) <= LEGEND_NODES else None
    flows = [_plot("Flows", "u_edge", legend=legend)] if topology.edges else []
    bound = steady_state(topology)
    steady = [_plot("Steady", "x", "x_oracle", axis=rrb.ScalarAxis(range=(-bound, bound)))] if bound > 0 else []
    return rrb.Grid(
        # All panels share one legend of nodes: the colours are the same, and a legend covers a part of its plot.
        rrb.Tabs(_plot("States x", "x", "x_oracle", legend=legend), *steady, _plot("w", "w")),
        rrb.Tabs(_plot("Inputs u", "u"), *flows),
        rrb.Tabs(
            _plot("Estimates", "ahat", "truth"),
            _plot("Error", "error"),
            _plot("a_LS", "a_ls"),
            _plot("Margin", "margin"),
            _plot("Right", "nodes_right"),
        ),
        rrb.Tabs(_plot("Regret", "regret"), _plot("Nominal gap", "nominal_gap")),
        *_totals(topology, gamma_star),
        grid_columns=3,
    )


def _aggregated(topology: Topology, gamma_star: float) -> rrb.Grid:
    nodes = len(topology.ids)
    heatmap = rrb.TensorView(
        origin="/heat",
        name="Heat map of |x|",
        scalar_mapping=rrb.TensorScalarMapping(colormap="Viridis", gamma=0.6, mag_filter="Nearest"),
        view_fit="Fill",
    )
    edge_inputs = [_plot("Flows", "u_edge")] if topology.edges else []
    return rrb.Grid(
        rrb.Tabs(
            _plot("States |x|", "quantiles/x", legend="RightTop"),
            _plot("x", "x"),
            _plot("x*", "x_oracle"),
            _plot("w", "w"),
        ),
        heatmap,
        rrb.Tabs(
            _plot(f"Right, of {nodes}", "nodes_right"),
            _plot("Estimates", "ahat"),
            _plot("Error", "error"),
            _plot("Truth", "truth"),
            _plot("a_LS", "a_ls"),
            _plot("Margin", "margin"),
        ),
        rrb.Tabs(
            _plot("Regret", "quantiles/regret", legend="RightTop"),
            _plot("Nodes", "regret"),
            _plot("Nominal gap", "nominal_gap"),
            _plot("|u|", "quantiles/u", legend="RightTop"),
            _plot("u", "u"),
            *edge_inputs,
        ),
        *_totals(topology, gamma_star),
        grid_columns=3,
    )


STARTS_HIGH = 4.0
"""the ratio from which the first states hide the later ones"""


def steady_state(topology: Topology) -> float:
    """Return the possible size of a state after x(0) has decayed, or 0 if x(0) is not much larger.

    It is max |w_i| / (1 - a_i) over the nodes, by the disturbances of the file.
    """
    network = topology.network
    bound = float((peak_of_nodes(topology) / (1 - network.a)).max(initial=0.0))
    return bound if bound > 0 and float(np.abs(network.x0).max(initial=0.0)) > STARTS_HIGH * bound else 0.0


def peak_of_nodes(topology: Topology) -> Matrix:
    """Return the peak of |w_i| of every node, (n,), by the disturbances of the file."""
    peak = np.zeros(len(topology.ids))
    for group in topology.network.disturbance:
        np.add.at(peak, group.nodes, peak_of(group.kind, group.values))
    return peak


def peak_of(kind: str, values: Mapping[str, NDArray[Any]]) -> Matrix:
    """Return the peak of |w_i| of a group of disturbances; noise exceeds it in a few of a thousand steps."""
    if kind in ("white", "ar1"):
        return np.asarray(3 * np.abs(values["std"]))
    if kind == "samples":
        return np.asarray(np.abs(values["values"]).max(axis=1, initial=0.0))
    name = {"sinusoid": "amplitude", "constant": "value"}.get(kind)
    return np.asarray(np.abs(values[name])) if name is not None else np.zeros(len(next(iter(values.values()), ())))


def _totals(topology: Topology, gamma_star: float) -> list[rrb.Tabs | rrb.TimeSeriesView]:
    """Return the panels of the costs."""
    # Start a little below 0: at the border, the number 0 would cover the first step of the axis of time.
    gain = rrb.ScalarAxis(range=(-0.25 * gamma_star, 4 * gamma_star), zoom_lock=False) if gamma_star > 0 else None
    return [
        rrb.Tabs(
            _plot("Regret D", "regret_sum", legend="RightBottom"),
            _plot("Cost R", "cost_regret"),
            _plot("Ratio", "cost_ratio"),
        ),
        # A large x(0) makes the first gains huge: start the axis where they are comparable.
        rrb.Tabs(
            _plot("Gain", "gain", legend=_free_corner(topology, gamma_star), axis=gain),
            _plot("Slack", "ceiling_slack"),
        ),
    ]


def _free_corner(topology: Topology, gamma_star: float) -> str:
    """Return the corner of the gain's panel for the legend.

    After x(0), the gain falls like sqrt(|x(0)|² / (t |w|²)) into an axis to 4 gamma*. A short run ends while it falls,
    so that the left corner is free; a long run ends below the legend.
    """
    power = float((peak_of_nodes(topology) ** 2).sum()) / 2
    enters = float((topology.network.x0**2).sum())
    return "LeftTop" if 6 * enters > topology.steps * power * (4 * gamma_star) ** 2 else "RightTop"


def _plot(
    title: str, *entities: str, legend: str | None = None, axis: rrb.ScalarAxis | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in entities],
        name=title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.auto(legend or "RightTop"), visible=legend is not None),
        axis_x=_whole(),
        axis_y=axis,
    )


def _whole() -> rrb.archetypes.TimeAxis:
    """Return a time axis over the whole run so far: by default, the viewer shows the last thousand steps of a live
    run.
    """
    boundary = rrb.TimeRangeBoundary.infinite()
    return rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=boundary, end=boundary))
