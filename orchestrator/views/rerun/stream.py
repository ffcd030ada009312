"""A run in Rerun: every metric of every step goes to run.rrd, and to a live viewer as far as it keeps up.

There are two recordings under one id, because a sink that stalls stops every sink beside it. One goes to the file
alone. The other belongs to a thread that drops data if its viewer is too slow; the run never waits for it. Importing
this module imports rerun, which costs a second of CPU: import it late.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch, Observer
from hedgerow.orchestrator.views.rerun.viewer import Viewer
from hedgerow.topologies.describe import describe
from hedgerow.topologies.errors import Code, HedgerowError
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import RoundTripTimes

# Rerun reads this once, on import. Without it, Rerun prints errors to the terminal when a viewer is closed.
os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk=off")
import rerun as rr

from hedgerow.orchestrator.runs.selection import selection
from hedgerow.orchestrator.views.event_texts import Now, about
from hedgerow.orchestrator.views.rerun.fault_timeline import Changes, FaultTimeline
from hedgerow.orchestrator.views.rerun.feed import Feeder, Write
from hedgerow.orchestrator.views.rerun.heatmap import HeatMap
from hedgerow.orchestrator.views.rerun.network_picture import Frames, Picture
from hedgerow.orchestrator.views.rerun.panels import (
    LARGE,
    ROUND_TRIPS,
    Matrix,
    RoundTripLines,
    aggregates,
    blueprint,
    lined,
    lines,
    totals,
)
from hedgerow.orchestrator.views.rerun.rrd_file import RrdFile

APPLICATION = "hedgerow"
CHUNK_ROWS, CHUNK_S = 200, 2.0
"""batches are joined in the file up to this number of rows or this time: each write costs 20 kB"""
FOOTER_STEPS = 10_000
"""a run with more steps has no index at the end of run.rrd, so its memory stays constant"""
PICTURES_HZ, PICTURES_HZ_LARGE, PICTURES_AT_ONCE = 20.0, 4.0, 200
"""the maximum number of steps per second with a picture and texts; and the maximum that is made up for at once"""
DRAWN_NODES = 200_000
"""the maximum number of nodes in all pictures of a replay: every step of 28 000 of paper7, otherwise every Nth"""
HEAT_S = 2.0
"""the time between two heat maps of a large network [s]"""


class Pace:
    """The choice of the steps with a picture: all, up to `hz` per second; the last of a batch if any.

    The about `past` first steps come at once; every `stride`-th of them is chosen.
    """

    def __init__(self, hz: float, past: int = 0, stride: int = 1) -> None:
        self._past, self._stride, self._seen = past, stride, 0
        self._hz, self._credit, self._last = hz, float(PICTURES_AT_ONCE), time.monotonic()

    def pick(self, rows: int) -> NDArray[np.int64]:
        """Return some of these rows, evenly spaced."""
        if self._seen < self._past:
            first = -self._seen % self._stride
            self._seen += rows
            return np.arange(first, rows, self._stride)
        now = time.monotonic()
        self._credit = min(PICTURES_AT_ONCE, self._credit + self._hz * (now - self._last))
        self._last = now
        some = min(rows, int(self._credit))
        self._credit -= some
        return np.arange(1, some + 1) * rows // max(some, 1) - 1


@dataclass(frozen=True)
class Texts:
    """The texts of the panel `now` at some steps."""

    t: NDArray[np.int64]
    wall: NDArray[np.float64]
    text: list[str]

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the texts."""
        columns = rr.TextDocument.columns(text=self.text, media_type=[rr.MediaType.MARKDOWN] * len(self.text))
        stream.send_columns("now", _index(self.t, self.wall), columns)

    @property
    def size(self) -> int:
        """Return the size [bytes]."""
        return sum(map(len, self.text))

    @staticmethod
    def joined(parts: Sequence[Texts]) -> Texts:
        """Return the parts as one."""
        t, wall = np.concatenate([part.t for part in parts]), np.concatenate([part.wall for part in parts])
        return Texts(t, wall, [text for part in parts for text in part.text])


@dataclass(frozen=True)
class Rows:
    """Some steps of some entities, ready to be written."""

    t: NDArray[np.int64]
    wall: NDArray[np.float64]
    """the time [s since 1970]"""
    columns: Mapping[str, Matrix]

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the rows, one entity at a time."""
        index = _index(self.t, self.wall)
        for entity, values in self.columns.items():
            stream.send_columns(entity, index, rr.Scalars.columns(scalars=values))

    @property
    def size(self) -> int:
        """Return the size of the numbers [bytes]."""
        return sum(values.nbytes for values in self.columns.values())

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Return parts with the same entities as one; leave out those without entities."""
        parts = [part for part in parts if part.columns] or parts[:1]
        columns = {entity: np.concatenate([part.columns[entity] for part in parts]) for entity in parts[0].columns}
        return Rows(np.concatenate([part.t for part in parts]), np.concatenate([part.wall for part in parts]), columns)


@dataclass(frozen=True)
class Drawn:
    """Some steps as pictures and texts."""

    frames: Frames
    texts: Texts

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the pictures and texts."""
        self.frames.write(stream)
        self.texts.write(stream)

    @property
    def size(self) -> int:
        """Return the size [bytes]."""
        return self.frames.size + self.texts.size

    @staticmethod
    def joined(parts: Sequence[Drawn]) -> list[Drawn]:
        """Return the parts as one, in a list; empty if there are none."""
        if not parts:
            return []
        return [Drawn(Frames.joined([part.frames for part in parts]), Texts.joined([part.texts for part in parts]))]


@dataclass(frozen=True)
class Part:
    """The display of a batch."""

    lines: Rows
    """the steps that have rows"""
    totals: Rows
    drawn: list[Drawn]
    changes: Changes

    def write(self, stream: rr.RecordingStream) -> None:
        """Send the display."""
        self.lines.write(stream)
        self.totals.write(stream)
        for drawn in self.drawn:
            drawn.write(stream)
        self.changes.write(stream)

    @property
    def size(self) -> int:
        """Return the approximate size [bytes]."""
        return self.lines.size + self.totals.size + sum(drawn.size for drawn in self.drawn) + self.changes.size

    @staticmethod
    def joined(parts: Sequence[Part]) -> Part:
        """Return the parts as one."""
        return Part(
            Rows.joined([part.lines for part in parts]),
            Rows.joined([part.totals for part in parts]),
            Drawn.joined([drawn for part in parts for drawn in part.drawn]),
            Changes.joined([part.changes for part in parts]),
        )


class RerunStream:
    """The stream of batches to run.rrd at `path` (None: no file) and to `viewer` (None: no viewer)."""

    def __init__(
        self,
        topology: Topology,
        observer: Observer,
        recording_id: str,
        path: Path | None,
        viewer: Viewer | None,
        part_bytes: int = 0,
        warn: Callable[[str], None] = lambda _: None,
        past: int = 0,
        processes: Sequence[str] = (),
    ) -> None:
        """Open the stream.

        A file has about `part_bytes` before the next begins, 0 for one file; `warn` reports problems of the viewer.

        The first `past` steps are finished already, so no clock limits the number of pictures. `processes` are the
        names for the answer times.
        """
        self._id = recording_id
        self._selection = selection(topology)
        self._nodes = lined(self._selection.nodes)
        self._lines, self._totals = lines(topology), totals(topology, observer) + aggregates(topology)
        large = len(topology.ids) > LARGE
        stride = -(-past * len(topology.ids) // DRAWN_NODES)
        self._pace = Pace(PICTURES_HZ_LARGE if large else PICTURES_HZ, past, max(1, stride))
        self._picture = Picture(topology)
        group = self._picture.groups.size if self._picture.groups is not None else 1
        self._about = about(topology, observer, large, PICTURES_HZ_LARGE if large else PICTURES_HZ, group)
        self._timeline = FaultTimeline(topology)
        self._now = Now(topology, observer)
        self._undrawn: tuple[Batch, NDArray[np.float64]] | None = None
        self._heatmap, self._heatmap_due = HeatMap(len(topology.ids)) if large else None, False
        self._plan = Plan(topology, observer)
        self._round_trips = RoundTripLines(processes)
        self._blueprint = blueprint(topology, topology.network.gamma_star_now, self._picture.legend, len(processes))
        self._wall = time.time()
        # Use a monotonic clock for the writes, because the wall clock may jump.
        self._written = self._heatmap_at = time.monotonic()
        self._unwritten: list[Part] = []
        self._unwritten_round_trips: list[Rows] = []
        footer = topology.steps <= FOOTER_STEPS
        self._file = RrdFile(path, self.opened, part_bytes, footer) if path is not None else None
        self._feeder = Feeder(viewer, self.opened, warn) if viewer is not None else None

    def opened(self, sink: rr.FileSink | rr.GrpcSink) -> rr.RecordingStream:
        """Return a recording into `sink` that has received all static data."""
        stream = rr.RecordingStream(APPLICATION, recording_id=self._id)
        if not rr.is_enabled(stream):
            switch = os.environ.get("RERUN", "")
            raise HedgerowError(
                f"Rerun is switched off by RERUN={switch} in the environment; unset it", code=Code.OPTION
            )
        stream.set_log_time_enabled(False)
        stream.set_sinks(sink, default_blueprint=self._blueprint)
        stream.send_recording_name(self._id)
        stream.log("about", rr.TextDocument(self._about, media_type=rr.MediaType.MARKDOWN), static=True)
        for quantity in (*self._lines, *self._totals):
            stream.log(quantity.entity, quantity.style(), static=True)
        if self._round_trips.names:
            stream.log(ROUND_TRIPS, self._round_trips.style(), static=True)
        self._picture.log_static(stream)
        for lane in list(self._timeline.begun.values()):
            lane.log_static(stream)
        return stream

    @property
    def missed(self) -> int:
        """Return the number of batches and events that the viewer missed; run.rrd has them all."""
        return self._feeder.dropped if self._feeder is not None else 0

    def log(self, batch: Batch, at: float | None = None) -> None:
        """Show the rows of a batch, which arrived at the time `at` [s since 1970, now]; never wait for a viewer."""
        # The steps of a batch share the time since the last batch: no single step has a time here.
        before, self._wall = self._wall, time.time() if at is None else at
        wall = np.linspace(before, self._wall, len(batch.t) + 1)[1:]
        for text, level, step in self._plan.due(batch):
            self.event(text, level, step)
        rows = self._selection.rows(batch.t)
        each = {q.entity: q.columns(batch)[rows] for q in self._lines} if len(rows) else {}
        sums = {q.entity: q.columns(batch) for q in self._totals}
        part = Part(
            Rows(batch.t[rows], wall[rows], each),
            Rows(batch.t, wall, sums),
            self._draw(batch, wall, self._pace.pick(len(batch.t))),
            self._timeline.changes(batch, wall),
        )
        if self._feeder is not None:
            self._feeder.put(part.write, part.size)
        if self._file is not None:
            self._unwritten.append(part)
            waiting = sum(len(part.totals.t) for part in self._unwritten)
            if waiting >= CHUNK_ROWS or time.monotonic() - self._written > CHUNK_S:
                self._write_batches(self._file)
        if self._heatmap is not None:
            self._heatmap.take(batch)
            self._heatmap_due = True
            if time.monotonic() - self._heatmap_at > HEAT_S:
                self._send_heatmap(self._heatmap.step)

    def round_trips(self, times: RoundTripTimes, at: float) -> None:
        """Show the answer times at some steps, the last of which ended at about `at`."""
        t = np.arange(times.t, times.t + len(times.seconds))
        rows = Rows(t, np.full(len(t), at), {ROUND_TRIPS: self._round_trips.columns(times)})
        if self._feeder is not None:
            self._feeder.put(rows.write, rows.size)
        if self._file is not None:
            self._unwritten_round_trips.append(rows)

    def _draw(self, batch: Batch, wall: NDArray[np.float64], rows: NDArray[np.int64]) -> list[Drawn]:
        """Return some rows of a batch as pictures; a batch without any is stored, in case it is the last."""
        self._undrawn = None if len(rows) else (batch, wall)
        if not len(rows):
            return []
        texts = Texts(batch.t[rows], wall[rows], self._now.texts(batch, rows))
        return [Drawn(self._picture.frames(batch, rows, wall), texts)]

    def _draw_last(self) -> None:
        if self._undrawn is not None:
            batch, wall = self._undrawn
            for drawn in self._draw(batch, wall, np.array([len(batch.t) - 1])):
                self._write(drawn.write, drawn.size)

    def _send_heatmap(self, step: int) -> None:
        """Send the heat map of all steps so far."""
        assert self._heatmap is not None
        self._heatmap_at, self._heatmap_due = time.monotonic(), False
        image, axes, (t, wall) = self._heatmap.image, self._heatmap.axes, _now(step)
        # Limit the scale to the 99 % quantile: one large x(0) would leave all else dark.
        most = max(float(np.quantile(image, 0.99)), 1e-6)

        def write(stream: rr.RecordingStream) -> None:
            stream.set_time("step", sequence=int(t[0]))
            stream.set_time("wall", timestamp=float(wall[0]))
            stream.log("heat", rr.Tensor(image, dim_names=axes, value_range=(0.0, most)))
            stream.reset_time()

        self._write(write, image.nbytes)

    def _write_batches(self, file: RrdFile) -> None:
        if self._unwritten:
            file.write(Part.joined(self._unwritten).write)
        if self._unwritten_round_trips:
            file.write(Rows.joined(self._unwritten_round_trips).write)
        self._unwritten, self._unwritten_round_trips, self._written = [], [], time.monotonic()

    def end(self, observer: Observer) -> None:
        """Show the states and the regret at step T, without an input; show nothing if the run ended before it."""
        if (end := observer.end) is None:
            return
        if self._heatmap is not None:
            self._send_heatmap(end.t)
        x, x_oracle, x_nominal = (of[self._nodes] for of in (end.x, observer.x_oracle_end, observer.x_nominal_end))
        last = {
            "x": x,
            "x_oracle": x_oracle,
            "x_nominal": x_nominal,
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

        Return True if all threads have ended. Otherwise a viewer blocks one of Rerun's threads, which would block the
        process: leave with os._exit. Raise HedgerowError if the file is incomplete.
        """
        by = time.monotonic() + deadline_s
        self._draw_last()
        if self._heatmap is not None and self._heatmap_due:
            self._send_heatmap(self._heatmap.step)
        if self._feeder is not None:
            self._feeder.finish(by)
        if self._file is not None:
            self._write_batches(self._file)
            self._file.close(deadline_s)
        return self._feeder is None or self._feeder.join(by)

    def _write(self, write: Write, size: int) -> None:
        if self._file is not None:
            self._file.write(write)
        if self._feeder is not None:
            self._feeder.put(write, size)


class Plan:
    """The announcements of the faults in the file: when they begin and end."""

    def __init__(self, topology: Topology, observer: Observer) -> None:
        self._faults, self._observer = topology.faults, observer

    def due(self, batch: Batch) -> list[tuple[str, str, int]]:
        """Return the lines (text, level, step) of the steps of a batch, in their order."""
        first, last = int(batch.t[0]), int(batch.t[-1])
        lines = []
        for number, fault in enumerate(self._faults):
            start, stop = fault.window
            if first <= start <= last:
                lines.append((f"fault {number + 1} begins: {_short(describe(fault))}", "WARN", start))
            # An early end was already reported.
            if first <= stop <= last and self._observer.topology.faults[number] == fault:
                lines.append((f"fault {number + 1} ends: {_short(describe(fault))}", "INFO", stop))
        return sorted(lines, key=lambda line: line[2])


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:50]} … {text[-27:]}"


def _now(step: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return np.array([step], dtype=np.int64), np.array([time.time()])


def _index(t: NDArray[np.int64], wall: NDArray[np.float64]) -> list[rr.TimeColumn]:
    """Return both timelines of some rows: the step, and the time [s since 1970]."""
    return [rr.TimeColumn("step", sequence=t), rr.TimeColumn("wall", timestamp=wall)]
