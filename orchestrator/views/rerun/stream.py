"""A run as Rerun shows it: every metric of every step into run.rrd, and to a live viewer as far as it keeps up.

Two recordings under one id, because a sink that stalls stops every sink beside it: one goes to the file and to
nothing else; the other belongs to a thread which nobody waits for, and which drops what its viewer has no time for.
Importing this module imports rerun, which costs a second of CPU: import it late.
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
from hedgerow.topologies.describe import describe, window
from hedgerow.topologies.errors import Code, HedgerowError
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import Trips

# Rerun reads this once, on import, and else writes lines to the terminal when a viewer is closed: no error of a run.
os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk=off")
import rerun as rr

from hedgerow.orchestrator.runs.selection import kept
from hedgerow.orchestrator.views.event_texts import Now, about
from hedgerow.orchestrator.views.rerun.fault_timeline import Changes, Lanes
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
"""batches are joined in the file up to this many rows or this long: a write costs 20 kB, however few its rows"""
FOOTER_STEPS = 10_000
"""a run of more steps leaves no index at the end of run.rrd: its memory stays as it is for as long as it goes on"""
PICTURES_HZ, PICTURES_HZ_LARGE, PICTURES_AT_ONCE = 20.0, 4.0, 200
"""steps that are drawn and put into words a second, if there are more; and how many may be made up for"""
DRAWN_NODES = 200_000
"""of a past that is played back, in all its pictures: every step of 28 000 of paper7, else every so many"""
HEAT_S = 2.0
"""how often the heat map of a large network is sent"""


class Pace:
    """Picks which steps are drawn: all, as long as they are no more than `hz` a second; the last of a batch if any.

    Of about `past` steps, which come first and all at once, every `stride`-th is.
    """

    def __init__(self, hz: float, past: int = 0, stride: int = 1) -> None:
        self._past, self._stride, self._seen = past, stride, 0
        self._hz, self._credit, self._last = hz, float(PICTURES_AT_ONCE), time.monotonic()

    def pick(self, rows: int) -> NDArray[np.int64]:
        """Some of this many rows, evenly."""
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
    """What the panel `now` says at some steps."""

    t: NDArray[np.int64]
    wall: NDArray[np.float64]
    text: list[str]

    def write(self, stream: rr.RecordingStream) -> None:
        """Send them."""
        columns = rr.TextDocument.columns(text=self.text, media_type=[rr.MediaType.MARKDOWN] * len(self.text))
        stream.send_columns("now", _index(self.t, self.wall), columns)

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(map(len, self.text))

    @staticmethod
    def joined(parts: Sequence[Texts]) -> Texts:
        """One after the other."""
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
        """Parts with the same entities, one after the other; those without any are left out."""
        parts = [part for part in parts if part.columns] or parts[:1]
        columns = {entity: np.concatenate([part.columns[entity] for part in parts]) for entity in parts[0].columns}
        return Rows(np.concatenate([part.t for part in parts]), np.concatenate([part.wall for part in parts]), columns)


@dataclass(frozen=True)
class Drawn:
    """Some steps as a picture, and in words."""

    frames: Frames
    texts: Texts

    def write(self, stream: rr.RecordingStream) -> None:
        """Send them."""
        self.frames.write(stream)
        self.texts.write(stream)

    @property
    def size(self) -> int:
        """Bytes."""
        return self.frames.size + self.texts.size

    @staticmethod
    def joined(parts: Sequence[Drawn]) -> list[Drawn]:
        """All in one, if there are any."""
        if not parts:
            return []
        return [Drawn(Frames.joined([part.frames for part in parts]), Texts.joined([part.texts for part in parts]))]


@dataclass(frozen=True)
class Part:
    """All that is shown of a batch."""

    lines: Rows
    """of the steps that have rows"""
    totals: Rows
    drawn: list[Drawn]
    changes: Changes

    def write(self, stream: rr.RecordingStream) -> None:
        """Send it."""
        self.lines.write(stream)
        self.totals.write(stream)
        for drawn in self.drawn:
            drawn.write(stream)
        self.changes.write(stream)

    @property
    def size(self) -> int:
        """Bytes, roughly."""
        return self.lines.size + self.totals.size + sum(drawn.size for drawn in self.drawn) + self.changes.size

    @staticmethod
    def joined(parts: Sequence[Part]) -> Part:
        """One after the other."""
        return Part(
            Rows.joined([part.lines for part in parts]),
            Rows.joined([part.totals for part in parts]),
            Drawn.joined([drawn for part in parts for drawn in part.drawn]),
            Changes.joined([part.changes for part in parts]),
        )


class RerunStream:
    """Streams batches to run.rrd at `path` (None: no file) and to `viewer` (None: nobody watches)."""

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
        """A file holds about `part_bytes` before the next begins, 0 for all; `warn` is told what ails the viewer.

        The first `past` steps are over already: no clock says how many of them are drawn. `processes` are those whose
        round trips are shown.
        """
        self._id = recording_id
        self._kept = kept(topology)
        self._nodes = lined(self._kept.nodes)
        self._lines, self._totals = lines(topology), totals(topology, observer) + aggregates(topology)
        large = len(topology.ids) > LARGE
        stride = -(-past * len(topology.ids) // DRAWN_NODES)
        self._pace = Pace(PICTURES_HZ_LARGE if large else PICTURES_HZ, past, max(1, stride))
        self._picture = Picture(topology)
        group = self._picture.groups.size if self._picture.groups is not None else 1
        self._about = about(topology, observer, large, PICTURES_HZ_LARGE if large else PICTURES_HZ, group)
        self._lanes = Lanes(topology, models=not large)
        self._now = Now(topology, observer)
        self._undrawn: tuple[Batch, NDArray[np.float64]] | None = None
        self._heat, self._heat_due = HeatMap(len(topology.ids)) if large else None, False
        self._plan = Plan(topology, observer)
        self._trips = RoundTripLines(processes)
        self._blueprint = blueprint(topology, topology.network.gamma_star_now, self._picture.legend, bool(processes))
        self._wall = time.time()
        # When to write is no matter of the wall clock, which may jump.
        self._written = self._heated = time.monotonic()
        self._unwritten: list[Part] = []
        self._unwritten_trips: list[Rows] = []
        footer = topology.steps <= FOOTER_STEPS
        self._file = RrdFile(path, self.opened, part_bytes, footer) if path is not None else None
        self._feeder = Feeder(viewer, self.opened, warn) if viewer is not None else None

    def opened(self, sink: rr.FileSink | rr.GrpcSink) -> rr.RecordingStream:
        """A recording that leads to `sink`, and has told it all that does not change."""
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
        if self._trips.names:
            stream.log(ROUND_TRIPS, self._trips.style(), static=True)
        self._picture.log_static(stream)
        for lane in list(self._lanes.begun.values()):
            lane.log_static(stream)
        return stream

    @property
    def missed(self) -> int:
        """Batches and events that the viewer had no time for; run.rrd has them all."""
        return self._feeder.dropped if self._feeder is not None else 0

    def log(self, batch: Batch, at: float | None = None) -> None:
        """Show the rows of a batch, which came at the time `at` [s since 1970, now]; never waits for a viewer."""
        # No step has a clock of its own here: those of a batch share the time since the last one.
        before, self._wall = self._wall, time.time() if at is None else at
        wall = np.linspace(before, self._wall, len(batch.t) + 1)[1:]
        for text, level, step in self._plan.due(batch):
            self.event(text, level, step)
        rows = self._kept.rows(batch.t)
        each = {q.entity: q.columns(batch)[rows] for q in self._lines} if len(rows) else {}
        sums = {q.entity: q.columns(batch) for q in self._totals}
        part = Part(
            Rows(batch.t[rows], wall[rows], each),
            Rows(batch.t, wall, sums),
            self._draw(batch, wall, self._pace.pick(len(batch.t))),
            self._lanes.changes(batch, wall),
        )
        if self._feeder is not None:
            self._feeder.put(part.write, part.size)
        if self._file is not None:
            self._unwritten.append(part)
            waiting = sum(len(part.totals.t) for part in self._unwritten)
            if waiting >= CHUNK_ROWS or time.monotonic() - self._written > CHUNK_S:
                self._write_batches(self._file)
        if self._heat is not None:
            self._heat.take(batch)
            self._heat_due = True
            if time.monotonic() - self._heated > HEAT_S:
                self._send_heat(self._heat.step)

    def round_trips(self, trips: Trips, at: float) -> None:
        """Show how long processes took to answer at some steps, the last of which ended about `at`."""
        t = np.arange(trips.t, trips.t + len(trips.seconds))
        rows = Rows(t, np.full(len(t), at), {ROUND_TRIPS: self._trips.columns(trips)})
        if self._feeder is not None:
            self._feeder.put(rows.write, rows.size)
        if self._file is not None:
            self._unwritten_trips.append(rows)

    def _draw(self, batch: Batch, wall: NDArray[np.float64], rows: NDArray[np.int64]) -> list[Drawn]:
        """Some rows of a batch; one without any is kept, in case that it is the last."""
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

    def _send_heat(self, step: int) -> None:
        """Send the heat map, of all steps so far."""
        assert self._heat is not None
        self._heated, self._heat_due = time.monotonic(), False
        image, axes, (t, wall) = self._heat.image, self._heat.axes, _now(step)
        # The brightest hundredth looks the same: one large x(0) would leave all else dark.
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
        if self._unwritten_trips:
            file.write(Rows.joined(self._unwritten_trips).write)
        self._unwritten, self._unwritten_trips, self._written = [], [], time.monotonic()

    def end(self, observer: Observer) -> None:
        """Show the states and the regret at step T, where no input acts; nothing if the run never got there."""
        if (end := observer.end) is None:
            return
        if self._heat is not None:
            self._send_heat(end.t)
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

        Returns whether all threads have ended. If not, a viewer holds one of Rerun's, which would hold the process:
        leave with os._exit. Raises HedgerowError if the file is not complete.
        """
        by = time.monotonic() + deadline_s
        self._draw_last()
        if self._heat is not None and self._heat_due:
            self._send_heat(self._heat.step)
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
    """The faults of the file, which nobody else announces: when they begin and end."""

    def __init__(self, topology: Topology, observer: Observer) -> None:
        self._faults, self._observer = topology.faults, observer

    def due(self, batch: Batch) -> list[tuple[str, str, int]]:
        """The lines (text, level, step) of the steps of a batch, in their order."""
        first, last = int(batch.t[0]), int(batch.t[-1])
        lines = []
        for number, fault in enumerate(self._faults):
            start, stop = window(fault)
            if first <= start <= last:
                lines.append((f"fault {number + 1} begins: {_short(describe(fault))}", "WARN", start))
            # Who healed it before has said so.
            if first <= stop <= last and self._observer.topology.faults[number] == fault:
                lines.append((f"fault {number + 1} ends: {_short(describe(fault))}", "INFO", stop))
        return sorted(lines, key=lambda line: line[2])


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:50]} … {text[-27:]}"


def _now(step: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return np.array([step], dtype=np.int64), np.array([time.time()])


def _index(t: NDArray[np.int64], wall: NDArray[np.float64]) -> list[rr.TimeColumn]:
    """Both timelines of some rows: the step, and the time [s since 1970]."""
    return [rr.TimeColumn("step", sequence=t), rr.TimeColumn("wall", timestamp=wall)]
