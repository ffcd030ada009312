"""A thread that sends data to a viewer; the run never waits for a viewer that does not read."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

import rerun as rr

from hedgerow.orchestrator.ground.bounded_queue import BoundedQueue
from hedgerow.orchestrator.views.rerun.viewer import Viewer
from hedgerow.orchestrator.views.rerun.viewer_version import compare

Write = Callable[[rr.RecordingStream], None]

WAITING_BYTES = 64 * 2**20
"""the maximum size of the queued data for a viewer [bytes]; beyond it, the oldest are dropped"""
POLL_S = 0.1
"""the time between two tries with a viewer that does not listen or does not read [s]"""


class Feeder:
    """A thread that writes to a viewer, which may stall, leave, come late or never come."""

    def __init__(
        self, viewer: Viewer, open_stream: Callable[[rr.GrpcSink], rr.RecordingStream], warn: Callable[[str], None]
    ) -> None:
        """Start the thread; it calls `warn` on any problem with the viewer."""
        self._viewer, self._open, self._warn = viewer, open_stream, warn
        self._writes: BoundedQueue[Write] = BoundedQueue(sys.maxsize, WAITING_BYTES)
        self._by: float | None = None
        self._stuck: rr.RecordingStream | None = None
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Return the size of the data queued for the viewer [bytes]."""
        return self._writes.bytes

    def put(self, write: Write, size: int) -> None:
        """Queue a write of about `size` bytes, and drop the oldest ones beyond WAITING_BYTES."""
        self.dropped += self._writes.put_or_drop(write, size)

    def finish(self, by: float) -> None:
        """Write the queued data until the monotonic time `by`; accept nothing more."""
        self._by = by
        self._writes.close()

    def join(self, by: float) -> bool:
        """Wait until `by`; return True if the thread has ended without a connection that could block."""
        self._thread.join(max(0.0, by - time.monotonic()))
        return not self._thread.is_alive() and self._stuck is None

    def _run(self) -> None:
        if self._until_it_listens():
            compare(self._viewer, self._warn)
            while not self._feed() and self._until_it_listens():
                pass
        self.dropped += self._writes.clear()

    def _until_it_listens(self) -> bool:
        """Wait for the viewer; return False if it does not come in time."""
        while not self._viewer.listens():
            # At the end of a run, wait for our own viewer if it is starting, but not for a separate one.
            hopeless = self._by is not None and self._viewer.process is None
            if self._viewer.gone or hopeless or self._late():
                return False
            time.sleep(POLL_S)
        return True

    def _feed(self) -> bool:
        """Send data over one connection; return True when all is sent, False when the connection broke."""
        stream = self._open(rr.GrpcSink(self._viewer.url))
        self._stuck = stream
        while (item := self._writes.take()) is not None:
            item[0](stream)
            if not self._taken(stream):
                self._writes.put_back(*item)
                self._stuck = None
                return False
            if self._late():
                return True
        stream.disconnect()
        self._stuck = None
        return True

    def _taken(self, stream: rr.RecordingStream) -> bool:
        """Wait until the viewer has received the last write, so Rerun never holds more than one batch.

        Above some megabytes, Rerun would block, and could not be closed. Return False if the connection broke.
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
