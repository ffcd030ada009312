"""A view of a running network from outside, from step 0: it reads the run's folder and sends no requests to the run.

    telemetry.arrows, edges.arrows ---> Trail ---> Observer ---> viewer
    topology.yaml (live faults) --------------------^  ^
    events.jsonl ---------------------------------------'

So it costs the run only the reading of two files, may start late, and may run twice.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.ground.spelling import spelled
from hedgerow.orchestrator.metrics.fault_accounts import at_ends
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.arrow_stream import read_batch
from hedgerow.orchestrator.runs.files import check_file, load_resolved, read_events, read_file, read_verdict, reading
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.runs.registry import Entry
from hedgerow.orchestrator.runs.round_trips import TABLE, processes_of, trips_in
from hedgerow.orchestrator.runs.selection import selection
from hedgerow.orchestrator.views.event_line import event_line
from hedgerow.orchestrator.views.rerun.stream import RerunStream
from hedgerow.orchestrator.views.rerun.viewer import Viewer, start
from hedgerow.orchestrator.views.rerun.viewer_version import VERSION_DEADLINE_S, compare
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.topologies.escape import command
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import TAKEN, End, Telemetry

Say = Callable[[str], None]

POLL_S = 0.2
ALIVE_EVERY_S = 1.0
"""the time between two checks that the run and the viewer still exist [s]"""
READ_STEPS = 2048
ROW_BYTES = 76
"""the size of a step and node in telemetry.arrows, if ids are numbers [bytes]"""
WAITING_BYTES = 8 * 2**20
"""the maximum size of the data queued for the viewer before more are read; nothing of a past is dropped"""
FROZEN_S = 10.0
"""the time without progress after which a viewer is reported as frozen [s]"""
CLOSE_DEADLINE_S = 30.0
MEMORY = "50%"
"""the share of the machine's memory for a viewer, or a page's server, that shows the whole past"""


class ArrowTail:
    """The reader of an Arrow stream that may still grow, batch by batch from the first."""

    def __init__(self, path: Path) -> None:
        check_file(path)
        self._path = path
        self._file = pa.OSFile(spelled(path), "rb")
        self._schema: pa.Schema | None = None
        self.over = False
        """its writer has closed it, and all was read"""

    @property
    def bytes(self) -> int:
        """Return the size of the stream so far [bytes]."""
        return int(self._file.size())

    def next(self) -> pa.RecordBatch | None:
        """Return the next complete batch; None if there is none yet."""
        before = at = self._file.tell()
        try:
            if self._schema is None:
                self._schema = pa.ipc.read_schema(self._file)
                at = self._file.tell()
            message = pa.ipc.read_message(self._file)
        except EOFError:  # nothing, or the end mark of a stream
            self.over = self._schema is not None and self._file.tell() > at
        except (pa.ArrowInvalid, OSError):  # an incomplete batch
            pass
        else:
            return read_batch(self._path, message, self._schema)
        self._file.seek(at if self._schema is not None else before)
        return None


class Trail:
    """The telemetry in the folder of a run, which may still grow.

    The tables contain all of it, with two exceptions. The used inputs are set to all inputs that arrived. Margins that
    are infinite, because there is only one candidate, are NaN.
    """

    def __init__(self, folder: Path, graph: Graph) -> None:
        """Open the streams; raise FileNotFoundError if they do not exist yet, or not any more."""
        self._folder = folder
        with reading(folder):
            self._telemetry = ArrowTail(folder / "telemetry.arrows")
            self._edges = ArrowTail(folder / "edges.arrows")
        self._graph, self._ends = graph, at_ends(graph)
        self._waiting: pa.RecordBatch | None = None
        self.end: End | None = None

    @property
    def past(self) -> int:
        """Return the approximate number of steps so far."""
        return self._telemetry.bytes // (ROW_BYTES * self._graph.n)

    @property
    def over(self) -> bool:
        """Return True if no more rows will come."""
        return self._telemetry.over and self._waiting is None

    def take(self, steps: int) -> list[Telemetry]:
        """Return new rows, about `steps` at most; raise UserError if the streams belong to another network."""
        rows: list[Telemetry] = []
        with reading(self._folder):
            while len(rows) < steps and (some := self._next()) is not None:
                rows += some
        return rows

    def _next(self) -> list[Telemetry] | None:
        """Return the rows of the next batch of both streams."""
        self._waiting = self._waiting or self._telemetry.next()
        if (nodes := self._waiting) is None:
            return None
        n, e = self._graph.n, len(self._graph.edges)
        if nodes["w"].null_count:  # no input acts at the last step
            self._waiting = None
            self.end = End(nodes["step"][0].as_py(), nodes["x"].to_numpy(), 0.0)
            return None
        edges = self._edges.next() if e else None
        if e and edges is None:  # it is written immediately after
            return None
        self._waiting = None
        t = nodes["step"].to_numpy()[::n]
        x, u, w = (_numbers(nodes, name).reshape(-1, n) for name in ("x", "u", "w"))
        report = np.stack([_numbers(nodes, name).reshape(-1, n) for name in ("ahat", "margin")], axis=1)
        is_open, link_up = np.ones((len(t), e), np.uint8), np.ones((len(t), 2 * e), np.uint8)
        if edges is not None:
            is_open[:] = _numbers(edges, "open").reshape(-1, e)
            for end, name in enumerate(("i_hears", "j_hears")):
                link_up[:, self._ends[:, end]] = _numbers(edges, name).reshape(-1, e)
        used = np.full(2 * e, TAKEN, np.uint8)
        return [
            Telemetry(int(step), x[k], u[k], w[k], report[k], is_open[k], link_up[k], used) for k, step in enumerate(t)
        ]


def _numbers(batch: pa.RecordBatch, name: str) -> Any:
    """Return a column, NaN where it is null."""
    return batch[name].to_numpy(zero_copy_only=False)


class Happenings:
    """The reader of events.jsonl, which may still grow."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0

    def new(self) -> Iterator[Mapping[str, Any]]:
        """Yield the events since the last call."""
        try:
            text = read_file(self._path, self._at)
        except FileNotFoundError:
            return
        with reading(self._path):
            yield from read_events(text, self._path)
        self._at += text.rfind(b"\n") + 1


def as_begun(topology: Topology, folder: Path) -> Topology:
    """Return a run's topology with only the faults of its file: added faults are shown when they begin."""
    begun = sum(event["event"] == "fault" and "at" not in event for event in Happenings(folder / "events.jsonl").new())
    return topology.model_copy(update={"faults": topology.faults[:begun]})


class PatientStream(RerunStream):
    """A stream to a viewer alone that waits for the viewer, because all of a past must arrive; it gives up after one
    timeout.

    A replay has time to wait, but the loop has not.
    """

    def __init__(
        self,
        topology: Topology,
        observer: Observer,
        name: str,
        viewer: Viewer,
        say: Say,
        past: int,
        processes: Sequence[str] = (),
    ) -> None:
        super().__init__(topology, observer, name, None, viewer, past=past, processes=processes)
        self._viewer, self._say = viewer, say
        self._complained = False

    @property
    def waiting(self) -> int:
        """Return the size of the numbers queued for the viewer [bytes]."""
        return self._feeder.waiting if self._feeder is not None else 0

    def wait(self, go_on: Callable[[], bool], below: int = WAITING_BYTES) -> None:
        """Wait until less than `below` is queued, or `go_on` returns False; raise HedgerowError if the viewer was
        closed.
        """
        least, since = self.waiting, time.monotonic()
        while (now := self.waiting) >= below and go_on():
            if now < least:
                least, since = now, time.monotonic()
            if time.monotonic() - since > FROZEN_S:
                self.check()
                if not self._complained:
                    self._complained = True
                    self._say(
                        f"the viewer at {self._viewer.url} has taken nothing for {FROZEN_S:g} s: it is frozen, or busy;"
                        " wake it up, or press Ctrl-C and use another; nothing is lost"
                    )
            time.sleep(0.02)

    def check(self) -> None:
        """Raise HedgerowError if the viewer has gone."""
        if self._viewer.gone:
            raise HedgerowError(
                "the viewer was closed; the run is untouched: the same command opens it again", code=Code.VIEWER
            )
        if not self._viewer.listens():
            raise HedgerowError(f"{self._viewer.url}: {self._viewer.unheard}; the run is untouched", code=Code.VIEWER)


def watch(entry: Entry, choice: str, say: Say) -> None:
    """Show a running network from step 0 until it ends or Ctrl-C; the viewer stays open.

    Raise UserError if there is no run to show, HedgerowError if the viewer fails.
    """
    folder = RunFolder(Path(entry.folder))
    wake = threading.Event()
    with Interrupts(wake.set) as interrupts:
        topology = load_resolved(folder.path)
        if not (what := selection(topology)).whole:
            raise UserError(
                f"{entry.run}: records only {what}, so it cannot be watched. Start it with --viewer, or see the"
                f" steps so far with `{command(['orchestrator', 'open', entry.folder])}`",
                code=Code.NOT_RECORDED,
            )
        if (trail := _attached(entry, topology, wake, interrupts)) is None:
            return
        viewer = start(choice, MEMORY, MEMORY)
        assert viewer is not None, "there is nothing to watch without"
        try:
            viewer.wait_until_it_listens()
            compare(viewer, say).join(VERSION_DEADLINE_S)
            say(f"{entry.run}: watch it at {viewer.link or viewer.url}; Ctrl-C stops watching, not the run")
            _Watch(entry, folder, topology, trail, viewer, say, interrupts, wake).follow()
            keep_page(viewer, interrupts, wake, say)
        finally:
            viewer.end()


def keep_page(viewer: Viewer, interrupts: Interrupts, wake: threading.Event, say: Say) -> None:
    """Serve a page until Ctrl-C; do nothing for a window."""
    if viewer.link is None or interrupts.count:
        return
    say(f"{viewer.link} stays until Ctrl-C")
    while not interrupts.count and not viewer.gone:
        wake.wait(POLL_S)


def _attached(entry: Entry, topology: Topology, wake: threading.Event, interrupts: Interrupts) -> Trail | None:
    """Return the trail of a run after its first step; None after Ctrl-C."""
    while not interrupts.count:
        try:
            return Trail(Path(entry.folder), topology.graph)
        except FileNotFoundError:
            over = any((Path(entry.folder) / name).exists() for name in ("telemetry.parquet", "verdict.json"))
            if over or entry not in registry.running():
                raise UserError(
                    f"{entry.run}: has just ended; `{command(['orchestrator', 'open', entry.folder])}` shows it",
                    code=Code.NETWORK_MISSING,
                ) from None
        wake.wait(POLL_S)
    return None


class _Watch:
    def __init__(
        self,
        entry: Entry,
        folder: RunFolder,
        topology: Topology,
        trail: Trail,
        viewer: Viewer,
        say: Say,
        interrupts: Interrupts,
        wake: threading.Event,
    ) -> None:
        self._entry, self._folder, self._trail = entry, folder, trail
        self._say, self._interrupts, self._wake = say, interrupts, wake
        topology = as_begun(topology, folder.path)
        self._observer = Observer(topology)
        # Do not use the name of the run: two views of it in one viewer would become one recording with all rows twice.
        name = f"{entry.run} watched at {time.strftime('%H:%M:%S')}-{time.monotonic_ns() % 1000:03}"
        processes = processes_of(folder.path, topology)
        self._round_trips: ArrowTail | None = None
        with contextlib.suppress(FileNotFoundError):  # the run uses no network, or it has just ended
            self._round_trips = ArrowTail(folder.path / f"{TABLE}.arrows")
        self._stream = PatientStream(topology, self._observer, name, viewer, say, trail.past, processes)
        self._happenings = Happenings(folder.events)
        self._file: tuple[int, int] | None = None
        """the version of topology.yaml that was read"""
        self._looked_at = 0.0
        self._alive = True

    def follow(self) -> None:
        try:
            while not self._interrupts.count:
                self._look()
                alive = self._alive
                if self._read():
                    self._stream.wait(lambda: not self._interrupts.count)
                elif self._trail.over or not alive:
                    self._end()
                    return
                else:
                    self._wake.wait(POLL_S)
        finally:
            self._stream.close(1.0 if self._interrupts.count else CLOSE_DEADLINE_S)

    def _look(self) -> None:
        """Check from time to time that the run and the viewer still exist."""
        if time.monotonic() - self._looked_at > ALIVE_EVERY_S:
            self._looked_at = time.monotonic()
            self._alive = self._entry in registry.running()
            self._stream.check()

    def _read(self) -> bool:
        """Show new rows; return True if there were any."""
        rows = self._trail.take(READ_STEPS)
        # A fault is in the file before its first step is recorded: read the file after the rows.
        status = self._folder.topology.stat()
        if (status.st_ino, status.st_mtime_ns) != self._file:
            self._file = (status.st_ino, status.st_mtime_ns)
            self._observer.change(load_resolved(self._folder.path))
        for event in self._happenings.new():
            if (line := event_line(event)) is not None:
                self._stream.event(*line)
        if rows:
            self._stream.log(self._observer.take(rows))
        while self._round_trips is not None and (batch := self._round_trips.next()) is not None:
            self._stream.round_trips(trips_in(batch), time.time())
        if self._trail.end is not None and self._observer.end is None:
            self._observer.finish(self._trail.end)
            self._stream.end(self._observer)
            return True
        return bool(rows)

    def _end(self) -> None:
        """Report the result of the run, when it is known."""
        while not self._folder.verdict.exists() and self._entry in registry.running() and not self._interrupts.count:
            self._wake.wait(POLL_S)
        if self._folder.verdict.exists():
            content = read_verdict(self._folder.path)
            text = Verdict(content["verdict"], content).line()
        else:
            text = (
                f"{self._entry.run}: was killed after step {self._observer.next_step - 1}; the recorded steps are shown"
            )
        self._stream.event(text, "INFO", self._observer.next_step)
        self._say(text)
