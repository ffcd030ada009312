"""The picture of the network at each step: states, wrong models, and faults.

The positions never change and are sent once; a drawn step consists of colours. Faults are drawn over the edges:

    i ========== j    open, messages both ways: grey and thin to white and thick, by the flow k_ij |u_j - u_i|
    i - - -===== j    i received no message of j: dashes at i's end
    i ==|    |== j    cut: a gap, and stumps
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.views import palette
from hedgerow.orchestrator.views.groups import Groups, Scene
from hedgerow.orchestrator.views.layout import Places, placed, positions
from hedgerow.orchestrator.views.palette import Packed, flow_colors, packed, state_colors, thickness
from hedgerow.orchestrator.views.rerun.name_places import name_places
from hedgerow.topologies.graph import Graph, Index, Mask
from hedgerow.topologies.record import WHOLE
from hedgerow.topologies.schema import Topology

NAMED = 40
"""the maximum number of nodes for names at all nodes; larger networks have names only at the WORST nodes"""
WORST = 5
DOT = 0.006
"""the minimum radius of a node as a part of the picture, for a visible colour; close nodes then hide their edges"""
SPARSE = 300
"""up to this number of nodes, all distances are compared"""
FADE = 0.85
"""the decay per step of the peak that sets the upper end of a scale"""
VIEW_PX = (427, 480)
"""the size of the picture in a window of 1280 by 800 [px]"""
COLORED = "each node's lines have the colour of its name"
"""the legend of the plots: a list of more than a few nodes would cover a plot or be clipped"""
_DASHES = np.array([[0.0, 0.26], [0.4, 0.62], [0.76, 0.96]])
_STUMP = 0.42
_HIDDEN, _LOST, _CUT, _BOTH = (packed(c) for c in (palette.BACKGROUND, palette.LOST, palette.CUT, palette.BOTH))


def decaying_peak(size: NDArray[np.float64], before: float) -> NDArray[np.float64]:
    """Return the decaying peak at each of some rows, (B,): the size, or FADE times the peak before."""
    fade = np.log(FADE) * np.arange(1, len(size) + 1)
    with np.errstate(divide="ignore"):
        peak = np.maximum.accumulate(np.maximum(np.log(size) - fade, np.log(before)))
    return np.asarray(np.exp(peak + fade))


@dataclass(frozen=True)
class Frames:
    """Some drawn steps; the number of faults differs from step to step, and `.._count` gives it, (R,)."""

    t: NDArray[np.int64]
    wall: NDArray[np.float64]
    """the time [s since 1970]"""
    nodes: Packed
    """(R, n)"""
    rings: Packed
    """(R, n)"""
    edges: Packed
    """the colour of each half edge, in the order of incidences, (R, 2E)"""
    widths: NDArray[np.float32]
    """(R, 2E)"""
    broken: NDArray[np.float32]
    """lines, (K, 2, 2)"""
    broken_color: Packed
    broken_count: Index
    dead: NDArray[np.float32]
    dead_count: Index
    worst: NDArray[np.float32]
    """places of the worst nodes, (R, W, 2)"""
    worst_name: NDArray[np.object_]
    """(R, W)"""
    top: NDArray[np.object_]
    """the |x| at the upper end of the scale, (R,)"""

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Return the parts as one."""
        return Frames(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Frames)))

    @property
    def size(self) -> int:
        """Return the size [bytes]."""
        return sum(getattr(self, f.name).nbytes for f in fields(self))

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the steps, one entity at a time."""
        index = [rr.TimeColumn("step", sequence=self.t), rr.TimeColumn("wall", timestamp=self.wall)]
        rows = len(self.t)

        def each(values: NDArray[np.generic]) -> list[int]:
            return [values.shape[1]] * rows

        for entity, colors in (("nodes", self.nodes), ("rings", self.rings)):
            columns = rr.Points2D.columns(colors=colors.ravel())
            stream.send_columns(f"network/{entity}", index, columns.partition(each(colors)))
        if self.edges.size:
            halves = rr.LineStrips2D.columns(colors=self.edges.ravel(), radii=self.widths.ravel())
            stream.send_columns("network/edges", index, halves.partition(each(self.edges)))
        broken = rr.LineStrips2D.columns(
            strips=list(self.broken), colors=self.broken_color, radii=np.full(len(self.broken), -2.25)
        )
        stream.send_columns("network/broken", index, broken.partition(self.broken_count))
        stream.send_columns(
            "network/dead", index, rr.LineStrips2D.columns(strips=list(self.dead)).partition(self.dead_count)
        )
        stream.send_columns("network/scale", index, rr.Points2D.columns(labels=self.top.tolist()))
        if self.worst.size:
            worst = rr.Points2D.columns(positions=self.worst.reshape(-1, 2), labels=self.worst_name.ravel().tolist())
            stream.send_columns("network/worst", index, worst.partition(each(self.worst_name)))


class Picture:
    """The painter of the steps of a network's run."""

    def __init__(self, topology: Topology) -> None:
        self._topology, self._ids = topology, topology.ids
        self.groups = Groups(topology.graph) if len(topology.ids) > WHOLE else None
        """groups, in a network too large for single nodes"""
        self._graph: Graph = topology.graph if self.groups is None else self.groups.graph
        self.places = placed(topology) if self.groups is None else positions(self._graph)
        self._large = self._graph.n > NAMED
        self._radius = _radius(self.places)
        self._width = 1.2 if self._large else 2.5
        """the width of an edge with the maximum flow [points]"""
        self._thickness = thickness(self._graph.weights, len(self._graph.edges))[self._graph.edge]
        """the thickness of each half edge; an edge with a lower weight is thinner"""
        self._x_peak = self._flow_peak = 0.0
        self._starts, self._middles = self._halves()
        self._nowhere = np.repeat(self.places[:1, None], 2, axis=1).astype(np.float32)
        """an invisible line: if a row has no line at all, Rerun keeps the lines of the previous row"""
        self.legend = Legend(self.places, self._radius, colored=1 < self._graph.n <= NAMED)

    def _halves(self) -> tuple[Places, Places]:
        """Return each half edge, from the rim of its node to the middle."""
        graph = self._graph
        near, far = self.places[graph.node], self.places[graph.neighbour]
        length = np.maximum(np.hypot(*(far - near).T), 1e-9)[:, None]
        rim = np.minimum(1.3 * self._radius, 0.3 * length)
        return near + (far - near) * rim / length, (near + far) / 2

    def log_static(self, stream: rr.RecordingStream) -> None:
        """Send the static parts: places, names, and the legend."""
        n = self._graph.n

        def points(entity: str, radius: float, order: float) -> None:
            # Send no colours here: static data would hide the changing data.
            stream.log(f"network/{entity}", rr.Points2D(self.places, radii=[radius] * n, draw_order=order), static=True)

        halves = np.stack([self._starts, self._middles], axis=1)
        if len(halves):
            stream.log("network/edges", rr.LineStrips2D(halves.astype(np.float32), draw_order=1.0), static=True)
        # Among many nodes, the marks of faults are short: draw them above the nodes.
        broken = rr.LineStrips2D.from_fields(draw_order=4.5 if self._large else 2.0)
        stream.log("network/broken", broken, static=True)
        points("rings", (1.35 if self._large else 1.45) * self._radius, 3.0)
        points("nodes", self._radius, 4.0)
        cross = rr.LineStrips2D.from_fields(colors=[palette.DEAD], radii=[-2.5], draw_order=5.0)
        stream.log("network/dead", cross, static=True)
        if self._large:
            worst = rr.Points2D.from_fields(colors=[palette.TEXT], radii=[-1.0], show_labels=True, draw_order=6.0)
            stream.log("network/worst", worst, static=True)
        else:
            named = [self._name(k) for k in range(n)]
            beside, _ = name_places(self.places, self._graph.edges, self._radius, named, self.legend.pixel)
            names = rr.Points2D(
                beside,
                radii=[0.001] * n,
                colors=palette.hues(n),
                labels=named,
                show_labels=True,
                draw_order=6.0,
            )
            stream.log("network/names", names, static=True)
        self.legend.log_static(stream)

    def _name(self, k: int) -> str:
        return self._topology.network.name(k) if self.groups is None else self.groups.name(k, self._ids)

    def frames(self, whole: Batch, rows: Index, wall: NDArray[np.float64]) -> Frames:
        """Draw some rows of a batch; all rows count for the scales, except if nodes are drawn in groups."""
        batch: Batch | Scene = whole
        wall = wall[rows]
        if self.groups is not None:
            batch, rows = self.groups.scene(whole, rows), np.arange(len(rows))
        x, flow = np.abs(batch.x), np.abs(np.nan_to_num(batch.u_edge))
        if self._graph.weights is not None:
            flow *= self._graph.weights
        x_peak = decaying_peak(x.max(axis=1), self._x_peak)
        flow_peak = decaying_peak(flow.max(axis=1, initial=0.0), self._flow_peak)
        self._x_peak, self._flow_peak = float(x_peak[-1]), float(flow_peak[-1])
        x, flow, x_peak, flow_peak = x[rows], flow[rows], x_peak[rows, None], flow_peak[rows, None]
        dead = batch.dead[rows]
        rings = np.full(x.shape, packed(palette.RIGHT))
        rings[batch.missing[rows]] = packed(palette.NO_INPUT)
        rings[batch.wrong[rows]] = packed(palette.WRONG)
        rings[dead] = packed(palette.DEAD)
        part = (flow / np.maximum(flow_peak, 1e-300))[:, self._graph.edge]
        cut, lost = ~batch.edge_open[rows][:, self._graph.edge], ~batch.link_up[rows]
        edges = flow_colors(part)
        edges[cut | lost] = _HIDDEN
        broken, broken_color, broken_count = self._broken(cut, lost)
        crosses, dead_count = self._crosses(dead)
        worst = np.argsort(-x, axis=1, kind="stable")[:, : WORST if self._large else 0]
        return Frames(
            t=batch.t[rows],
            wall=wall,
            nodes=state_colors(x / np.maximum(x_peak, 1e-300)),
            rings=rings,
            edges=edges,
            widths=(-self._width * (0.4 + part) * self._thickness).astype(np.float32),
            broken=broken,
            broken_color=broken_color,
            broken_count=broken_count,
            dead=crosses,
            dead_count=dead_count,
            worst=(self.places[worst]).astype(np.float32),
            worst_name=np.array([[self._name(k) for k in row] for row in worst.tolist()], dtype=np.object_).reshape(
                worst.shape
            ),
            top=np.array([f"|x| = {peak:.3g}" for peak in x_peak[:, 0]], dtype=np.object_),
        )

    def _broken(self, cut: Mask, lost: Mask) -> tuple[NDArray[np.float32], Packed, Index]:
        """Return dashes where i lacks j's message, and stumps where an edge is cut; each row starts with an invisible
        line.
        """
        dashed, stumps = lost & ~cut, cut
        row, c = dashed.nonzero()
        start, way = self._starts[c], self._middles[c] - self._starts[c]
        dashes = start[:, None, None] + way[:, None, None] * _DASHES[None, :, :, None]
        row_cut, c_cut = stumps.nonzero()
        near, way = self._starts[c_cut], self._middles[c_cut] - self._starts[c_cut]
        tip = near + _STUMP * way
        length = np.maximum(np.hypot(*way.T), 1e-9)[:, None]
        across = np.stack([-way[:, 1], way[:, 0]], axis=1) / length * np.minimum(0.8 * self._radius, length)
        bars = np.stack([np.stack([near, tip], axis=1), np.stack([tip - across, tip + across], axis=1)], axis=1)
        both = np.where(lost[row_cut, c_cut], _BOTH, _CUT)
        rows = np.arange(len(cut))
        return _by_row(
            [rows, np.repeat(row, 3), np.repeat(row_cut, 2)],
            [np.repeat(self._nowhere, len(rows), axis=0), dashes.reshape(-1, 2, 2), bars.reshape(-1, 2, 2)],
            [np.full(len(rows), _HIDDEN), np.full(3 * len(row), _LOST), np.repeat(both, 2)],
        )

    def _crosses(self, dead: Mask) -> tuple[NDArray[np.float32], Index]:
        row, node = dead.nonzero()
        arm = 0.95 * self._radius * np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]])
        lines = (self.places[node][:, None, None] + arm).reshape(-1, 2, 2)
        rows = np.arange(len(dead))
        hidden = np.repeat(self._nowhere, len(rows), axis=0)
        found, _, count = _by_row(
            [rows, np.repeat(row, 2)], [hidden, lines], [np.zeros(len(rows)), np.zeros(len(lines))]
        )
        return found, count


def _by_row(
    rows: Sequence[Index], lines: Sequence[NDArray[np.floating]], colors: Sequence[NDArray[np.generic]]
) -> tuple[NDArray[np.float32], Packed, Index]:
    """Return all lines in the order of their rows, their colours, and the number of lines per row."""
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    count = np.bincount(row, minlength=len(rows[0]))
    drawn, color = np.concatenate(lines).astype(np.float32), np.concatenate(colors).astype(np.uint32)
    return drawn[order], color[order], count


def _radius(places: Places) -> float:
    """Return the largest radius for which most nodes do not touch, at least that of a dot."""
    if len(places) == 1:
        return 0.2
    if len(places) <= SPARSE:
        apart = np.hypot(*(places[:, None] - places).T)
        nearest = np.partition(apart, 1, axis=1)[:, 1]
    else:
        from scipy.spatial import cKDTree  # noqa: PLC0415 (a third of a second, which a few nodes need not cost)

        nearest = cKDTree(places).query(places, k=2)[0][:, 1]
    return float(max(min(0.33 * np.quantile(nearest, 0.05), 0.2), DOT * np.ptp(places, axis=0).max(), 1e-6))


class Legend:
    """The legend of the colours, below the network, and the bounds of both."""

    def __init__(self, places: Places, radius: float, colored: bool = False) -> None:
        low, high = places.min(axis=0) - 3 * radius, places.max(axis=0) + 3.5 * radius
        width, height = np.maximum(high - low, 1.0)
        self._unit = unit = max(float(width) / 6, float(height) / 4)
        centre = float(low[0] + high[0]) / 2
        self.x = centre + unit * np.linspace(-2.45, 2.45, 5)
        """the x of the symbols, in two rows with names below"""
        self.y = float(high[1]) + unit * np.array([0.45, 1.1])
        self.x_range = (centre - 3.1 * unit, centre + 3.1 * unit)
        self.colored = colored
        """True if the names have the colours of the lines"""
        self.y_range = (float(low[1]), float(high[1]) + (2.05 if colored else 1.65) * unit)
        self.pixel = max(6.2 * unit / VIEW_PX[0], (self.y_range[1] - self.y_range[0]) / VIEW_PX[1])
        """the length of a pixel in a window of 1280 by 800"""

    def log_static(self, stream: rr.RecordingStream) -> None:
        """Send the symbols."""
        unit, (first, second) = self._unit, self.y
        size, length = 0.11 * unit, 0.3 * unit
        nodes = np.array([[x, first] for x in self.x])
        rings = [palette.RIGHT, palette.RIGHT, palette.WRONG, palette.NO_INPUT, palette.DEAD]
        fills = state_colors(np.array([0.0, 1.0, 0.3, 0.3, 0.3]))
        stream.log("network/legend/rings", rr.Points2D(nodes, radii=1.45 * size, colors=rings), static=True)
        stream.log("network/legend/nodes", rr.Points2D(nodes, radii=size, colors=fills, draw_order=40.0), static=True)
        x, y = nodes[-1]
        arms = 0.95 * size * np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]]) + [x, y]
        cross = rr.LineStrips2D(arms, colors=[palette.DEAD], radii=[-1.5], draw_order=41.0)
        stream.log("network/legend/dead", cross, static=True)

        lines, colors, widths = [], [], []

        def line(x: float, start: float, stop: float, color: object, width: float) -> None:
            lines.append([[x + start * length, second], [x + stop * length, second]])
            colors.append(color)
            widths.append(-width)

        one_way, both_ways, cut = self.x[2:]
        weak, strong = (int(color) for color in flow_colors(np.array([0.0, 1.0])))
        line(self.x[0], -1, 1, weak, 1.0)
        line(self.x[1], -1, 1, strong, 3.5)
        line(one_way, 0, 1, palette.GREY, 1.5)
        for side, x in ((-1, one_way), (-1, both_ways), (1, both_ways)):
            for start, stop in 1 - _DASHES:
                line(x, side * start, side * stop, palette.LOST, 2.25)
        line(cut, -1, -0.5, palette.CUT, 2.25)
        line(cut, 0.5, 1, palette.CUT, 2.25)
        for end in (cut - 0.5 * length, cut + 0.5 * length):
            lines.append([[end, second - 0.08 * unit], [end, second + 0.08 * unit]])
            colors.append(palette.CUT)
            widths.append(-2.25)
        packed_colors = [color if isinstance(color, int) else int(packed(color)) for color in colors]  # type: ignore[arg-type]
        shown = rr.LineStrips2D(lines, colors=packed_colors, radii=widths)
        stream.log("network/legend/edges", shown, static=True)

        words = ["x = 0", "", "wrong model", "no input", "agent dead"]
        words += ["no flow", "strong flow", "lost one", "lost both", "edge cut"]
        below = np.array([[x, y + 0.2 * unit] for y in (first, second) for x in self.x])
        labelled = [k for k, word in enumerate(words) if word]
        at, said = below[labelled], [words[k] for k in labelled]
        if self.colored:
            at, said = np.vstack([at, [self.x[2], second + 0.6 * unit]]), [*said, COLORED]
        stream.log(
            "network/legend/words",
            rr.Points2D(at, radii=[-0.1] * len(said), colors=[palette.TEXT] * len(said), labels=said, show_labels=True),
            static=True,
        )
        scale = rr.Points2D([below[1]], radii=[-0.1], colors=[palette.TEXT], show_labels=True)
        stream.log("network/scale", scale, static=True)
