"""The recording of one run: it turns telemetry into tables, a Rerun recording and a verdict."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from hedgerow.orchestrator.ground.background import BackgroundThread
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.guarantee import certified, plant_of
from hedgerow.orchestrator.metrics.observer import Batch, Observer, rows_at_once
from hedgerow.orchestrator.metrics.replay import Replay
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict, judge
from hedgerow.orchestrator.runs.folder import RunFolder, write_json
from hedgerow.orchestrator.views.rerun.viewer import Viewer, start
from hedgerow.topologies.errors import HedgerowError, UserError
from hedgerow.topologies.regular_file import open_regular
from hedgerow.topologies.resolve import text_beside_table
from hedgerow.topologies.schema import Topology
from hedgerow.wire import crash
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.message import End, RoundTripTimes, Telemetry

if TYPE_CHECKING:
    from hedgerow.orchestrator.runs.round_trips import RoundTrips
    from hedgerow.orchestrator.runs.writer import Recorder
    from hedgerow.orchestrator.views.rerun.stream import RerunStream
    from hedgerow.orchestrator.views.screen import Screen

CLOSE_DEADLINE_S = 5.0
RERUN_DEADLINE_S = 30.0
"""the longest time for one job of Rerun [s]: after a failed write, some of its calls never return"""
BOUNDS_DEADLINE_S = 120.0
"""the longest time for the bounds [s]: at a limit of memory, the solver may never return"""
CERTIFIED = 10_000
"""The maximum number of nodes for a computation of the gain bounds beside the run. The end of the run waits for it."""
TABLES = ("telemetry", "edges", "summary")
"""the names of the tables; `record:` can omit the summary"""


class Recording:
    """The recorder of one run: it feeds the observer and stores the results."""

    def __init__(
        self,
        topology: Topology,
        folder: RunFolder,
        watching: Watching,
        ending: Ending,
        processes: Sequence[str] = (),
        replayed: bool = True,
    ) -> None:
        """Open the recording; `processes` are those that answer states, in the order of their shards.

        `replayed` adds a replay's checks.
        """
        self._processes = processes
        self._round_trips: RoundTrips | None = None
        """the answer times in a run over Zenoh, from the first step on"""
        self.topology, self.folder, self.ending = topology, folder, ending
        self.observer = Observer(topology)
        self.rows_at_once = rows_at_once(self.observer.graph.n)
        self._watching = watching
        self._background: BackgroundThread | None = None
        """the thread that feeds the stream: loading Rerun takes a second, and the run does not wait for it"""
        self._replaying: BackgroundThread | None = None
        """the thread of the replay: its step takes as long as that of an agent, and the loop must not wait"""
        self._replayed = replayed
        self._stream: RerunStream | None = None
        self._left_out = False
        self._bounding: BackgroundThread | None = None
        """the thread that computes the gain bounds: it begins after the first step"""
        if len(topology.ids) <= CERTIFIED:
            self.observer.adaptive = GainCertificate(plant_of(topology.network), self.observer.x0)
        else:
            self.observer.not_certified = (
                f"{len(topology.ids)} nodes are more than {CERTIFIED}; `orchestrator bound` takes larger networks"
            )
        self._notes: list[tuple[str, str, int]] = []
        """the notes from before the stream existed"""
        self.viewer: Viewer | None = None
        self.warnings: deque[str] = deque()
        """warnings about the viewer that `warn` prints; other threads append to it"""
        self._watched = False

    @property
    def page_stays(self) -> bool:
        """Return True if the page of the viewer stays after the run, until Ctrl-C."""
        return self._watching.keep or (self.viewer is not None and self.viewer.door is not None)

    @cached_property
    def _recorder(self) -> Recorder:
        # Loading Arrow takes time: the processes of the run must start first.
        from hedgerow.orchestrator.runs.writer import Recorder  # noqa: PLC0415

        return Recorder(self.topology, self.folder.path)

    def take(self, rows: Sequence[Telemetry]) -> Batch | None:
        """Observe and record some steps, at most `rows_at_once`; return None if all were recorded before.

        Raise OSError when the disk is full.
        """
        if not (rows := self.observer.in_order(rows)):
            return None
        batch = self.observer.take(rows)
        if self._processes and self._round_trips is None:
            from hedgerow.orchestrator.runs.round_trips import RoundTrips  # noqa: PLC0415

            self._round_trips = RoundTrips(self._processes, self.folder.path)
        self._replay(rows, batch.size)
        self._bound()
        self._recorder.write(batch)
        if not self._watched:
            self._watched = True
            self._open_stream()
        at = time.time()
        self._show(lambda stream: stream.log(batch, at), batch.size)
        return batch

    def _replay(self, rows: Sequence[Telemetry], size: int) -> None:
        if not self._replayed:
            return
        if self._replaying is None:
            self._replaying = BackgroundThread("replay", self._leave_out_replay)
            first = self.topology  # the faults at the first step, before any later change
            self._replaying.do(lambda: self._begin_replay(first))
        self._replaying.do(lambda: self._take_replayed(rows), size)

    def _bound(self) -> None:
        """Compute the gain bounds beside the run, after its first step."""
        certificate = self.observer.adaptive
        if certificate is None or self._bounding is not None:
            return

        def solve() -> None:
            certificate.known = certified(plant_of(self.topology.network), self.topology.network.gamma_star)

        self._bounding = BackgroundThread("the solver of the bounds", self._leave_out_bounds, BOUNDS_DEADLINE_S)
        self._bounding.do(solve)

    def _leave_out_bounds(self, error: BaseException) -> None:
        """Continue without the certificate, which is only one of several checks."""
        reached = limit_reached(error)
        expected = isinstance(error, HedgerowError | OSError | ImportError) or reached is not None
        why = str(reached or error) if expected else crash.report(error, self.folder.logs / "orchestrator.log")
        self.observer.adaptive, self.observer.not_certified = None, why

    def _leave_out_replay(self, error: BaseException) -> None:
        """Continue without the replay after a defect in it; the verdict is unknown, and names the file of the
        traceback.
        """
        self.ending.replay = None
        self.ending.not_replayed = crash.report(error, self.folder.logs / "orchestrator.log")

    def _begin_replay(self, topology: Topology) -> None:
        try:
            self.ending.replay = Replay(topology)
        except HedgerowError as error:  # a law that only the agents' machine can load
            self.ending.not_replayed = str(error)
        except Exception as error:  # a failure of the replay, such as a lack of memory, must not end the run
            self.ending.not_replayed = f"{type(error).__name__}: {error}"

    def _take_replayed(self, rows: Sequence[Telemetry]) -> None:
        if self.ending.replay is not None:
            self.ending.replay.take(rows)

    def _change_replayed(self, topology: Topology) -> None:
        if self.ending.replay is not None:
            self.ending.replay.change(topology)

    def take_round_trips(self, times: RoundTripTimes) -> None:
        """Record the answer times of the processes at some recorded steps; OSError as in `take`."""
        assert self._round_trips is not None, "they come after their steps"
        self._round_trips.take(times)
        at = time.time()
        self._show(lambda stream: stream.round_trips(times, at))

    def finish(self, end: End) -> None:
        """Record the final state."""
        self.observer.finish(end)
        self._recorder.write_end(self.observer, end)
        self._show(lambda stream: stream.end(self.observer))
        self.note(f"the run ended after {end.t} steps", "INFO", end.t)

    def change(self, topology: Topology) -> None:
        """Change the faults from the next step on, for the observer and in the run's topology.yaml.

        Raise OSError when the disk is full.
        """
        self.topology = topology
        self.observer.change(topology)
        if self._replaying is not None:
            self._replaying.do(lambda: self._change_replayed(topology))
        part = self.folder.topology.with_name("topology.yaml.part")
        try:
            part.write_text(text_beside_table(topology), encoding="utf-8")
            part.rename(self.folder.topology)
        finally:
            part.unlink(missing_ok=True)

    def note(self, text: str, level: str, step: int) -> None:
        """Show a line in the viewer's events; `level` is INFO, WARN or ERROR."""
        if self._watched:
            self._show(lambda stream: stream.event(text, level, step))
        else:
            self._notes.append((text, level, step))

    def tell_faults(self) -> None:
        """Record the faults that the file schedules."""
        for number, fault in enumerate(self.topology.faults, 1):
            self.folder.event("fault", fault=number, entry=fault.written())

    def warn(self, screen: Screen) -> None:
        """Print the new warnings about the viewer."""
        while self.warnings:
            screen.say(self.warnings.popleft())

    def _open_stream(self) -> None:
        if not self._watching.record and self._watching.viewer == "none":
            return
        path = self.folder.recording if self._watching.record else None
        try:
            self.viewer = start(self._watching.viewer)
        except (OSError, HedgerowError) as error:
            self.warnings.append(
                f"no viewer: {str(limit_reached(error) or error).rstrip('.')}; the run continues without it"
            )
        if path is None and self.viewer is None:
            return
        self._background = BackgroundThread("Rerun", self._leave_out, RERUN_DEADLINE_S)
        self._background.do(lambda: self._load(path))
        for note in self._notes:
            self.note(*note)
        self.folder.event(
            "recording", path=str(path) if path else None, viewer=self.viewer.url if self.viewer else None
        )

    def _load(self, path: Path | None) -> None:
        from hedgerow.orchestrator.views.rerun.stream import RerunStream  # noqa: PLC0415

        part_bytes = int(self._watching.split_mb * 1e6)
        stream = RerunStream(
            self.topology,
            self.observer,
            self.folder.name,
            path,
            self.viewer,
            part_bytes,
            self.warnings.append,
            processes=self._processes,
        )
        if not self._left_out:  # it came too late
            self._stream = stream

    def _leave_out(self, error: BaseException) -> None:
        """Continue without the recording and the viewer, which are optional, and warn once."""
        self._stream, self._left_out = None, True
        why = str(limit_reached(error) or error)
        expected = isinstance(error, HedgerowError | OSError | ImportError) or limit_reached(error) is not None
        if not expected:
            why = crash.report(error, self.folder.logs / "orchestrator.log")
        what = "run.rrd is not complete" if self._watching.record else "the viewer is left out"
        self.warnings.append(f"{what}: {why.rstrip('.')}; the run continues without it")

    def _show(self, show: Callable[[RerunStream], object], size: int = 0) -> None:
        def job() -> None:
            if self._stream is not None:  # it is loaded first
                show(self._stream)

        if self._background is not None:
            self._background.do(job, size)

    def close_tables(self) -> None:
        """Write the final form of the tables, once the bounds are known; no step can be recorded after that."""
        self._close_bounds()
        self._recorder.close(self.observer.adaptive)
        if self._round_trips is not None:
            self._round_trips.close()

    def _close_bounds(self) -> None:
        """Wait for the bounds, and check the steps that came before them."""
        if self._bounding is not None:
            self._bounding.close()
        if self.observer.adaptive is not None:
            self.observer.adaptive.finish()

    def _close_stream(self) -> None:
        try:
            if self._stream is not None and not self._stream.close(CLOSE_DEADLINE_S):
                self.folder.event("viewer_stalled", deadline_s=CLOSE_DEADLINE_S)
        except (OSError, HedgerowError) as error:
            self._leave_out(error)

    def close(self) -> Verdict:
        """Close the tables and the recording, judge the run and write the verdict."""
        try:
            if self._replaying is not None:
                self._replaying.close()
            self._close_bounds()
            if self._background is not None:
                self._background.do(self._close_stream)
                self._background.close()
            self.close_tables()
        # A full disk: the stream files hold the recorded steps, and can be read.
        except (OSError, HedgerowError) as error:
            self.ending.stopped = self.ending.stopped or str(error)
        if self._round_trips is not None:
            self.ending.round_trips = self._round_trips.summary()
        verdict = judge(self.topology, self.observer, self.ending)
        with contextlib.suppress(OSError):
            self.folder.event("verdict", verdict=verdict.verdict, reasons=verdict.content["reasons"])
            write_json(self.folder.verdict, verdict.content)
        return verdict


def same_tables(one: Path, other: Path) -> bool:
    """Return True if two run folders hold the same tables, bit for bit.

    A summary has checksums over all nodes and steps. The claims of the certificate are compared only if both runs have
    them: a solver may run out of time.
    """
    differ = [name for name in TABLES if _digest(one / f"{name}.parquet") != _digest(other / f"{name}.parquet")]
    return not differ or (differ == ["summary"] and _same_summaries(one, other))


def _same_summaries(one: Path, other: Path) -> bool:
    """Return True if two summaries differ only because one of them has no claims of the certificate."""
    from hedgerow.orchestrator.runs.table import Table  # noqa: PLC0415
    from hedgerow.orchestrator.runs.writer import CLAIMS  # noqa: PLC0415

    try:
        left, right = (Table(folder, "summary").whole() for folder in (one, other))
        unclaimed = any(table[name].null_count == table.num_rows for table in (left, right) for name in CLAIMS)
        return unclaimed and bool(left.drop_columns(CLAIMS).equals(right.drop_columns(CLAIMS)))
    except (UserError, KeyError):
        return False


def _digest(file: Path) -> bytes | None:
    """Return the SHA-256 of a file, read in pieces; None if it is absent."""
    if not file.exists():
        return None
    with open_regular(file) as opened:
        return hashlib.file_digest(opened, "sha256").digest()
