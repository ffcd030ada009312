"""What Rerun shows of a run: its quantities, where they stand on the screen, and what it is all about."""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from orchestrator.observe import Batch, Observer
from topologies.schema import Topology

Matrix = NDArray[np.float64]
Color = tuple[int, int, int, int]

LEGEND_NODES = 10
"""larger networks have no legend of nodes: it would cover the plot, and pointing at a line names it too"""


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
    node, pale = _hues(len(ids)), _hues(len(ids), alpha=140)
    limit = observer.gamma_star

    def gains(batch: Batch) -> Matrix:
        gamma_star = np.full(len(batch.t), limit)
        return np.stack([batch.gain(), batch.gain(float(observer.v0)), gamma_star], axis=1)

    def sums(batch: Batch) -> Matrix:
        return np.stack([batch.regret_sum, batch.nominal_regret_sum], axis=1)

    listed = [
        Quantity("x", lambda batch: batch.x, ids, node),
        Quantity("x_oracle", lambda batch: batch.x_oracle, _each(ids, "oracle"), pale, 1.0),
        Quantity("u", lambda batch: batch.u, ids, node, steps=True),
        Quantity("u_edge", lambda batch: batch.u_edge, edges, _hues(len(edges)), steps=True),
        Quantity("w", lambda batch: batch.w, ids, node, steps=True),
        Quantity("ahat", lambda batch: batch.ahat, ids, node, 2.0, steps=True),
        Quantity("truth", lambda batch: batch.a, _each(ids, "truth"), pale, 1.0, steps=True),
        Quantity("a_ls", lambda batch: batch.a_ls, ids, node),
        Quantity("margin", lambda batch: batch.margin, ids, node),
        Quantity("nodes_right", lambda batch: batch.right, ["nodes right"], [GREEN], steps=True),
        Quantity("regret", lambda batch: batch.regret, ids, node),
        Quantity("nominal_gap", lambda batch: batch.nominal_gap, ids, node),
        Quantity("regret_sum", sums, [topology.law, "nominal"], [GREEN, ORANGE], 2.0),
        Quantity("cost_regret", lambda batch: batch.cost_regret, ["R"], [GREEN], 2.0),
        Quantity("cost_ratio", lambda batch: batch.ratio, ["cost / oracle's cost"], [GREEN], 2.0),
        Quantity("gain", gains, ["gain", "gain less x(0)", "γ* (oracle)"], [ORANGE, GREEN, GREY], 2.0),
    ]
    return [quantity for quantity in listed if quantity.names]


GREEN: Color = (90, 200, 120, 255)
ORANGE: Color = (240, 150, 60, 255)
GREY: Color = (170, 170, 170, 255)


def _each(ids: Sequence[str], what: str) -> list[str]:
    return [f"{node} {what}" for node in ids]


def _hues(count: int, alpha: int = 255) -> list[Color]:
    """A colour a node, by its place in the file: each a golden section of the circle from the last."""
    rgb = (colorsys.hsv_to_rgb(0.55 + k * 0.6180339887 % 1, 0.6, 0.95) for k in range(count))
    return [(int(255 * r), int(255 * g), int(255 * b), alpha) for r, g, b in rgb]


def blueprint(nodes: int, edges: int) -> rrb.Blueprint:
    """The layout: six plots that tell the run, the other quantities in tabs behind them, and what it is about."""
    edge_inputs = [_plot("Edge inputs u_j − u_i", "u_edge")] if edges else []
    plots = rrb.Grid(
        rrb.Tabs(_plot("States x (pale: oracle's)", "x", "x_oracle"), _plot("Disturbances w", "w")),
        # One legend of nodes for all panels: the colours are the same, and it covers a part of the plot.
        rrb.Tabs(_plot("Inputs u", "u", legend="RightBottom" if nodes <= LEGEND_NODES else None), *edge_inputs),
        rrb.Tabs(
            _plot("Estimates â (pale: truth a)", "ahat", "truth"),
            _plot("a_LS", "a_ls"),
            _plot("Margin J₂ − J₁ [x²]", "margin"),
            _plot("Nodes right", "nodes_right"),
        ),
        rrb.Tabs(_plot("Regret |x − x*| [x]", "regret"), _plot("Nominal gap |x* − x_nom| [x]", "nominal_gap")),
        rrb.Tabs(
            _plot("Cumulative regret D = Σ|x − x*|² [x²]", "regret_sum", legend="RightBottom"),
            _plot("Cost regret R [x²]", "cost_regret"),
            _plot("Cost ratio", "cost_ratio"),
        ),
        _plot("Gain √(Σcost / Σ|w|²)", "gain", legend="RightTop"),
        grid_columns=2,
    )
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="/about", name="About"),
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["loglevel", "body"]),
        ),
        row_shares=[5, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(plots, words, column_shares=[7, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="step", play_state="following"),
    )


def _plot(title: str, *entities: str, legend: str | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in entities],
        name=title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.auto(legend or "RightTop"), visible=legend is not None),
    )


def about(topology: Topology, observer: Observer) -> str:
    """What a newcomer needs to read the panels, in Markdown."""
    return f"""\
# {topology.name}

law **{topology.law}**, {len(topology.ids)} nodes, {len(topology.edges)} edges, T = {topology.steps},
b = {topology.b:g}, γ\\* = {observer.gamma_star:.4g}, ρ = {observer.rho:.4g}, seed {topology.seed}

A colour is a node, the same in all panels. The *oracle* is the same network, with the same disturbances and x(0),
whose nodes know their true a; *nominal* is the same again with a fixed guess of a.

- **States** x, and the oracle's x\\*.
- **Inputs** u; edge (i, j) carries u_j − u_i.
- **Estimates** â: the candidate that fits a node's past best. Under sinusoids it need not become the truth:
  least squares tend to a + Σxw / Σx².
- **Regret** |x − x\\*| of each node.
- **Cumulative regret** D: its squares, summed over nodes and steps; and the same of the nominal law.
  *Cost regret* R is the cost less the oracle's, and may be negative.
- **Gain** of the disturbance so far; the cost of a step is |x|² + |u_e|². *Less x(0)* leaves out what x(0) may
  have cost.

**γ\\* is the oracle's number**, the least gain that can be promised when every a is known. It is no guarantee of
the adaptive law, which may exceed it.

Whatever the estimates: |x(t+1)|₁ ≤ ρ |x(t)|₁ + |w(t)|₁.

x, u, w in the units of the file; [x] and [x²] are in units of x and their square.
"""
