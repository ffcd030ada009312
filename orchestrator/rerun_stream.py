"""A run as Rerun shows it: every metric of every step into run.rrd, and to a live viewer as far as it keeps up.

Two recordings under one id, because a sink that stalls stops every sink beside it: one goes to the file and to
nothing else; the other belongs to a thread which nobody waits for, and which drops what its viewer has no time for.
Importing this module imports rerun, which costs a second of CPU: import it late.
"""

from __future__ import annotations

import colorsys
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.observe import Batch, Observer
from orchestrator.viewer import Viewer
from topologies.errors import HedgerowError
from topologies.schema import Topology

# Rerun reads this once, on import, and else writes lines to the terminal when a viewer is closed: no error of a run.
os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk=off")
import rerun as rr
import rerun.blueprint as rrb

Matrix = NDArray[np.float64]
Color = tuple[int, int, int, int]
Write = Callable[[rr.RecordingStream], None]

APPLICATION = "hedgerow"
WAITING_BYTES = 64 * 2**20
"""numbers that may wait for a viewer; the oldest are dropped beyond"""
CHUNK_ROWS, CHUNK_S = 200, 2.0
"""batches are joined in the file up to this many rows or this long: a write costs 20 kB, however few its rows"""
POLL_S = 0.1
"""how often a viewer is tried that does not listen or does not take what it was sent"""
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


@dataclass(frozen=True)
class Rows:
    """Some steps of some entities, ready to be written."""

    t: NDArray[np.int64]
    wall: NDArray[np.float64]
    """the time [s since 1970]"""
    columns: Mapping[str, Matrix]

    def write(self, stream: rr.RecordingStream) -> None:
        """Send them, an entity at a time."""
        index = _index(self.t, self.wall)
        for entity, values in self.columns.items():
            stream.send_columns(entity, index, rr.Scalars.columns(scalars=values))

    @property
    def size(self) -> int:
        """Bytes of the numbers."""
        return sum(values.nbytes for values in self.columns.values())

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Parts with the same entities, one after the other."""
        columns = {entity: np.concatenate([part.columns[entity] for part in parts]) for entity in parts[0].columns}
        return Rows(np.concatenate([part.t for part in parts]), np.concatenate([part.wall for part in parts]), columns)


class RerunStream:
    """Streams batches to run.rrd at `path` (None: no file) and to `viewer` (None: nobody watches)."""

    def __init__(
        self,
        topology: Topology,
        observer: Observer,
        recording_id: str,
        path: Path | None,
        viewer: Viewer | None,
    ) -> None:
        self._id, self._path = recording_id, path
        self._quantities = quantities(topology, observer)
        self._about = about(topology, observer)
        self._blueprint = blueprint(len(topology.ids), len(topology.edges))
        self._wall = self._written = time.time()
        self._unwritten: list[Rows] = []
        self._file = None
        if path is not None:
            try:
                self._file = self._open(rr.FileSink(path))
            except RuntimeError as error:
                raise self._unwritable(error) from None
        self._feeder = Feeder(viewer, self._open) if viewer is not None else None

    def _open(self, sink: rr.FileSink | rr.GrpcSink) -> rr.RecordingStream:
        """A recording that leads to `sink`, and has told it all that does not change."""
        stream = rr.RecordingStream(APPLICATION, recording_id=self._id)
        stream.set_log_time_enabled(False)
        stream.set_sinks(sink, default_blueprint=self._blueprint)
        stream.send_recording_name(self._id)
        stream.log("about", rr.TextDocument(self._about, media_type=rr.MediaType.MARKDOWN), static=True)
        for quantity in self._quantities:
            stream.log(quantity.entity, quantity.style(), static=True)
        return stream

    @property
    def missed(self) -> int:
        """Batches and events that the viewer had no time for; run.rrd has them all."""
        return self._feeder.dropped if self._feeder is not None else 0

    def log(self, batch: Batch) -> None:
        """Show the rows of a batch; never waits for a viewer."""
        # No step has a clock of its own here: those of a batch share the time since the last one.
        before, self._wall = self._wall, time.time()
        wall = np.linspace(before, self._wall, len(batch.t) + 1)[1:]
        rows = Rows(batch.t, wall, {q.entity: q.columns(batch) for q in self._quantities})
        if self._feeder is not None:
            self._feeder.put(rows.write, rows.size)
        if self._file is not None:
            self._unwritten.append(rows)
            if sum(len(rows.t) for rows in self._unwritten) >= CHUNK_ROWS or self._wall - self._written > CHUNK_S:
                self._write_batches(self._file)

    def _write_batches(self, file: rr.RecordingStream) -> None:
        if self._unwritten:
            Rows.joined(self._unwritten).write(file)
        self._unwritten, self._written = [], self._wall

    def end(self, observer: Observer) -> None:
        """Show the states and the regret at step T, where no input acts; nothing if the run never got there."""
        if (end := observer.end) is None:
            return
        x, x_oracle, x_nominal = end.x, observer.x_oracle_end, observer.x_nominal_end
        last = {
            "x": x,
            "x_oracle": x_oracle,
            "regret": np.abs(x - x_oracle),
            "nominal_gap": np.abs(x_oracle - x_nominal),
            "regret_sum": np.array([observer.regret_sum, observer.nominal_regret_sum]),
        }
        t, wall = _now(end.t)
        rows = Rows(t, wall, {entity: row[None] for entity, row in last.items()})
        self._write(rows.write, rows.size)

    def event(self, text: str, level: str, step: int) -> None:
        """Show one line of the log; `level` is INFO, WARN or ERROR."""
        index = _index(*_now(step))
        columns = rr.TextLog.columns(text=[text], level=[level])
        self._write(lambda stream: stream.send_columns("events", index, columns), len(text))

    def close(self, deadline_s: float) -> bool:
        """Complete the file and let the viewer catch up, within the deadline.

        Returns whether all threads have ended. If not, a viewer holds one of Rerun's, which would hold the process:
        leave with os._exit. Raises HedgerowError if the file is not complete.
        """
        by = time.monotonic() + deadline_s
        if self._feeder is not None:
            self._feeder.finish(by)
        if self._file is not None:
            self._write_batches(self._file)
            try:
                self._file.flush(timeout_sec=max(deadline_s, 1.0))
            except RuntimeError as error:
                raise self._unwritable(error) from None
            self._file.disconnect()
        return self._feeder is None or self._feeder.join(by)

    def _unwritable(self, error: RuntimeError) -> HedgerowError:
        return HedgerowError(
            f"{self._path}: is not complete: {error}; see that the disk has room and the folder can be written"
        )

    def _write(self, write: Write, size: int) -> None:
        if self._file is not None:
            write(self._file)
        if self._feeder is not None:
            self._feeder.put(write, size)


def _now(step: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return np.array([step], dtype=np.int64), np.array([time.time()])


def _index(t: NDArray[np.int64], wall: NDArray[np.float64]) -> list[rr.TimeColumn]:
    """Both timelines of some rows: the step, and the time [s since 1970]."""
    return [rr.TimeColumn("step", sequence=t), rr.TimeColumn("wall", timestamp=wall)]


class Feeder:
    """A thread that brings writes to a viewer which may stall, go away, come late or never come."""

    def __init__(self, viewer: Viewer, open_stream: Callable[[rr.GrpcSink], rr.RecordingStream]) -> None:
        self._viewer, self._open = viewer, open_stream
        self._waiting: deque[tuple[Write, int]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._by: float | None = None
        self._stuck: rr.RecordingStream | None = None
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    def put(self, write: Write, size: int) -> None:
        """Queue a write of about `size` bytes, and drop the oldest ones beyond WAITING_BYTES."""
        with self._changed:
            self._waiting.append((write, size))
            self._bytes += size
            while self._bytes > WAITING_BYTES and len(self._waiting) > 1:
                self._bytes -= self._waiting.popleft()[1]
                self.dropped += 1
            self._changed.notify()

    def finish(self, by: float) -> None:
        """Nothing more is put: bring what waits, until the monotonic time `by`."""
        with self._changed:
            self._by = by
            self._changed.notify()

    def join(self, by: float) -> bool:
        """Wait until `by`; whether the thread has ended and left nothing behind that could block."""
        self._thread.join(max(0.0, by - time.monotonic()))
        return not self._thread.is_alive() and self._stuck is None

    def _run(self) -> None:
        while self._until_it_listens() and not self._feed():
            pass
        with self._changed:
            self.dropped += len(self._waiting)
            self._waiting.clear()

    def _until_it_listens(self) -> bool:
        """Wait for the viewer; False when it will not come, or not in time."""
        while not self._viewer.listens():
            # At the end of a run our own viewer, which is starting, is worth waiting for; a stranger's is not.
            hopeless = self._by is not None and self._viewer.process is None
            if self._viewer.gone or hopeless or self._late():
                return False
            time.sleep(POLL_S)
        return True

    def _feed(self) -> bool:
        """Bring writes over one connection; True when there are no more, False when the connection broke."""
        stream = self._open(rr.GrpcSink(self._viewer.url))
        self._stuck = stream
        while (item := self._next()) is not None:
            item[0](stream)
            if not self._taken(stream):
                with self._changed:
                    self._waiting.appendleft(item)
                    self._bytes += item[1]
                self._stuck = None
                return False
            if self._late():
                return True
        stream.disconnect()
        self._stuck = None
        return True

    def _next(self) -> tuple[Write, int] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._by is not None)
            if not self._waiting:
                return None
            item = self._waiting.popleft()
            self._bytes -= item[1]
            return item

    def _taken(self, stream: rr.RecordingStream) -> bool:
        """Wait until the viewer has what was written, so that no more than one batch is ever inside Rerun.

        Beyond some megabytes Rerun would block, and could not be closed. False when the connection is broken.
        """
        while not self._late():
            try:
                stream.flush(timeout_sec=POLL_S)
            except RuntimeError as error:
                if "timed out" in str(error):
                    continue
                return False
            return True
        return True

    def _late(self) -> bool:
        return self._by is not None and time.monotonic() > self._by - 2 * POLL_S


def quantities(topology: Topology, observer: Observer) -> list[Quantity]:
    """What is shown of a batch: an entity each, named as the field of Batch that it shows."""
    ids = [str(node) for node in topology.ids]
    edges = [f"{i}–{j}" for i, j in topology.edges]
    node, pale = _hues(len(ids)), _hues(len(ids), alpha=140)
    truth, limit = observer.a, observer.gamma_star

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
        Quantity("truth", lambda b: np.tile(truth, (len(b.t), 1)), _each(ids, "truth"), pale, 1.0),
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
