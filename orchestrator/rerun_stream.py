"""A run as Rerun shows it: every metric of every step into run.rrd, and to a live viewer as far as it keeps up.

Two recordings under one id, because a sink that stalls stops every sink beside it: one goes to the file and to
nothing else; the other belongs to a thread which nobody waits for, and which drops what its viewer has no time for.
Importing this module imports rerun, which costs a second of CPU: import it late.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.observe import Batch, Observer
from orchestrator.viewer import Viewer
from topologies.errors import HedgerowError
from topologies.schema import Topology

# Rerun reads this once, on import, and else writes lines to the terminal when a viewer is closed: no error of a run.
os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk=off")
import rerun as rr

from orchestrator.feeder import Feeder, Write
from orchestrator.panels import Matrix, about, blueprint, quantities

APPLICATION = "hedgerow"
CHUNK_ROWS, CHUNK_S = 200, 2.0
"""batches are joined in the file up to this many rows or this long: a write costs 20 kB, however few its rows"""


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
