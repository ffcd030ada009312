"""What Rerun shows of a run: its quantities, and where they stand on the screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from orchestrator.lanes import LANES
from orchestrator.observe import Batch, Observer
from orchestrator.palette import BACKGROUND, GREEN, GREY, ORANGE, Color, hues
from orchestrator.palette import CUT as RED
from orchestrator.palette import LOST as AMBER
from orchestrator.palette import NO_INPUT as BLUE
from orchestrator.picture import Legend
from topologies.schema import Topology

Matrix = NDArray[np.float64]

LEGEND_NODES = 10
"""larger networks have no legend of nodes: it would cover the plot; the picture and pointing at a line name them too"""
LARGE = 24
"""networks of more nodes are shown by quantiles and counts, with the plots of every node in tabs behind"""


@dataclass(frozen=True)
class Quantity:
    """One entity of the recording: k series over the steps, named and coloured once."""

    entity: str
    of: Callable[[Batch], NDArray[Any]]
    """the columns of a batch of B steps, (B, k) or (B,)"""
    names: Sequence[str]
    colors: Sequence[Color]
    width: float = 1.5
    steps: bool = False
    """whether the values hold until the next step, rather than lead to it"""

    def style(self) -> rr.SeriesLines:
        """Names, colours and widths [points] of the k series."""
        mode = rr.components.InterpolationMode
        return rr.SeriesLines(
            names=self.names,
            colors=self.colors,
            widths=[self.width] * len(self.names),
            interpolation_mode=mode.StepAfter if self.steps else mode.Linear,
        )

    def columns(self, batch: Batch) -> Matrix:
        """The series, (B, k); what is infinite has no place in a plot and becomes NaN."""
        values = np.asarray(self.of(batch), dtype=np.float64).reshape(len(batch.t), -1)
        return np.where(np.isinf(values), np.nan, values)


def quantities(topology: Topology, observer: Observer) -> list[Quantity]:
    """What is shown of a batch: an entity each, named as the field of Batch that it shows."""
    ids = [str(node) for node in topology.ids]
    edges = [f"{i}–{j}" for i, j in topology.edges]
    node, pale = hues(len(ids)), hues(len(ids), alpha=140)
    limit = observer.gamma_star

    def gains(batch: Batch) -> Matrix:
        gamma_star = np.full(len(batch.t), limit)
        return np.stack([batch.gain(), batch.gain(float(observer.v0)), gamma_star], axis=1)

    def sums(batch: Batch) -> Matrix:
        return np.stack([batch.regret_sum, batch.nominal_regret_sum], axis=1)

    listed = [
        Quantity("x", lambda batch: batch.x, ids, node),
        Quantity("x_oracle", lambda batch: batch.x_oracle, _each(ids, "oracle"), pale, 1.0),
        Quantity("x_nominal", lambda batch: batch.x_nominal, _each(ids, "nominal"), pale, 1.0),
        Quantity("u", lambda batch: batch.u, ids, node, steps=True),
        Quantity("u_edge", lambda batch: batch.u_edge, edges, hues(len(edges)), steps=True),
        Quantity("w", lambda batch: batch.w, ids, node, steps=True),
        Quantity("ahat", lambda batch: batch.ahat, ids, node, 2.0, steps=True),
        Quantity("index", _named, ids, node, steps=True),
        Quantity("truth", lambda batch: batch.a, _each(ids, "truth"), pale, 1.0, steps=True),
        Quantity("a_ls", lambda batch: batch.a_ls, ids, node),
        Quantity("margin", lambda batch: batch.margin, ids, node),
        Quantity("nodes_right", lambda batch: batch.right, ["nodes right"], [GREEN], steps=True),
        Quantity("regret", lambda batch: batch.regret, ids, node),
        Quantity("nominal_gap", lambda batch: batch.nominal_gap, ids, node),
        Quantity("regret_sum", sums, [topology.law, "nominal"], [GREEN, ORANGE], 2.0),
        Quantity("cost_regret", lambda batch: batch.cost_regret, ["R"], [GREEN], 2.0),
        Quantity("cost_ratio", lambda batch: batch.ratio, ["cost / oracle's cost"], [GREEN], 2.0),
        Quantity("gain", gains, ["gain", "gain less x(0)", "γ* (oracle's)"], [ORANGE, GREEN, GREY], 2.0),
    ]
    return [quantity for quantity in listed if quantity.names]


def _named(batch: Batch) -> Matrix:
    """Which candidates the estimates are, from 0; -1 for none of them, and a gap where there is no estimate."""
    return np.where(np.isnan(batch.ahat), np.nan, batch.index)


def aggregates(topology: Topology) -> list[Quantity]:
    """What is shown of a large network in place of a line a node: computed for the viewer, and told by no table."""
    if len(topology.ids) <= LARGE:
        return []
    names, colors = ["largest", "90 %", "median"], [ORANGE, GREEN, GREY]

    def counts(batch: Batch) -> NDArray[Any]:
        down = (~batch.edge_open, ~batch.link_up, np.isnan(batch.u))
        return np.stack([which.sum(axis=1) for which in down], axis=1)

    return [
        Quantity("quantiles/x", lambda batch: _quantiles(np.abs(batch.x)), names, colors),
        Quantity("quantiles/regret", lambda batch: _quantiles(batch.regret), names, colors),
        Quantity("quantiles/u", lambda batch: _quantiles(np.abs(np.nan_to_num(batch.u))), names, colors, steps=True),
        Quantity("quantiles/down", counts, list(DOWN), [RED, AMBER, BLUE], 2.0, steps=True),
    ]


DOWN = ("edges cut", "messages lost", "nodes without input")


def _quantiles(values: Matrix) -> Matrix:
    """The largest, the 90 % and the median of each row."""
    n = values.shape[1]
    at = [n - 1, int(0.9 * (n - 1)), (n - 1) // 2]
    return np.asarray(np.partition(values, at, axis=1)[:, at])


def _each(ids: Sequence[str], what: str) -> list[str]:
    return [f"{node} {what}" for node in ids]


def blueprint(topology: Topology, gamma_star: float, legend: Legend) -> rrb.Blueprint:
    """The layout: the network and how it fares at the left; six plots, the faults and the events at the right."""
    nodes = len(topology.ids)
    large = nodes > LARGE
    network = rrb.Spatial2DView(
        origin="/network",
        name=f"Network: {topology.name}, fill by |x| [x], edges by |u_j − u_i|",
        background=list(BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=legend.x_range, y_range=legend.y_range),
    )
    words = rrb.Tabs(
        rrb.TextDocumentView(origin="/now", name="Now"),
        rrb.TextDocumentView(origin="/about", name="About this run"),
        active_tab=0,
    )
    told = rrb.Vertical(network, words, row_shares=[5, 2])
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["loglevel", "body"]),
    )
    title = f"Faults (the first {LANES} links and nodes with any)" if large else "Faults and wrong models by link, node"
    lanes = rrb.StateTimelineView(origin="/faults", name=title, time_view=_whole())
    if large:
        down = _plot("Down [count]", "quantiles/down", legend="LeftTop")
        happened = rrb.Horizontal(down, lanes, events, column_shares=[2, 3, 2])
    else:
        happened = rrb.Horizontal(lanes, events, column_shares=[3, 2])
    plots = _aggregated(topology, gamma_star) if large else _plots(topology, gamma_star)
    return rrb.Blueprint(
        rrb.Horizontal(told, rrb.Vertical(plots, happened, row_shares=[2.4, 1]), column_shares=[1, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
    )


def _plots(topology: Topology, gamma_star: float) -> rrb.Grid:
    legend = "RightBottom" if len(topology.ids) <= LEGEND_NODES else None
    edge_inputs = [_plot("Edge flows u_j − u_i [u]", "u_edge", legend=legend)] if topology.edges else []
    return rrb.Grid(
        rrb.Tabs(_plot("States x [x], pale: oracle's", "x", "x_oracle"), _plot("Disturbances w [x]", "w")),
        # One legend of nodes for all panels: the colours are the same, and it covers a part of the plot.
        rrb.Tabs(_plot("Inputs u [u]", "u", legend=legend), *edge_inputs),
        rrb.Tabs(
            _plot("Estimates â [1], pale: truth", "ahat", "truth"),
            _plot("a_LS [1]", "a_ls"),
            _plot("Margin J₂ − J₁ [x²]", "margin"),
            _plot("Nodes right", "nodes_right"),
        ),
        rrb.Tabs(_plot("Regret |x − x*| [x]", "regret"), _plot("Nominal gap |x* − x_nom| [x]", "nominal_gap")),
        *_totals(gamma_star),
        grid_columns=3,
    )


def _aggregated(topology: Topology, gamma_star: float) -> rrb.Grid:
    nodes = len(topology.ids)
    heat = rrb.TensorView(
        origin="/heat",
        name="Heat map: |x| [x], largest of each patch",
        scalar_mapping=rrb.TensorScalarMapping(colormap="Viridis", gamma=0.6, mag_filter="Nearest"),
        view_fit="Fill",
    )
    edge_inputs = [_plot("Edge flows u_j − u_i [u]", "u_edge")] if topology.edges else []
    return rrb.Grid(
        rrb.Tabs(
            _plot("|x| [x]: largest, 90 %, median", "quantiles/x", legend="RightTop"),
            _plot("States x [x], every node", "x"),
            _plot("Oracle's x* [x]", "x_oracle"),
            _plot("w [x]", "w"),
        ),
        heat,
        rrb.Tabs(
            _plot(f"Right models [of {nodes}]", "nodes_right"),
            _plot("Estimates â [1], every node", "ahat"),
            _plot("Truth a [1]", "truth"),
            _plot("a_LS [1]", "a_ls"),
            _plot("Margin [x²]", "margin"),
        ),
        rrb.Tabs(
            _plot("Regret [x]: largest, 90 %, median", "quantiles/regret", legend="RightTop"),
            _plot("Every node", "regret"),
            _plot("Nominal gap [x]", "nominal_gap"),
            _plot("|u| [u]: largest, 90 %, median", "quantiles/u", legend="RightTop"),
            _plot("Inputs u [u], every node", "u"),
            *edge_inputs,
        ),
        *_totals(gamma_star),
        grid_columns=3,
    )


def _totals(gamma_star: float) -> list[rrb.Tabs | rrb.TimeSeriesView]:
    """What it costs."""
    gain = rrb.ScalarAxis(range=(0.0, 4 * gamma_star), zoom_lock=False)
    return [
        rrb.Tabs(
            _plot("Cumulative regret D [x²]", "regret_sum", legend="RightBottom"),
            _plot("Cost regret R [x²]", "cost_regret"),
            _plot("Cost ratio [1]", "cost_ratio"),
        ),
        # A large x(0) makes the first gains huge: the axis begins where they can be compared.
        _plot("Gain √(Σcost / Σ|w|²) [1], axis to 4 γ*", "gain", legend="LeftTop", axis=gain),
    ]


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
    """The whole run so far: left alone, the viewer shows the last thousand steps of a run that goes on."""
    boundary = rrb.TimeRangeBoundary.infinite()
    return rrb.archetypes.TimeAxis(view_range=rr.TimeRange(start=boundary, end=boundary))
