"""File descriptor 2 of a process, escaped on its way to the terminal or the log."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
import threading
from types import TracebackType

from hedgerow.topologies.escape import EscapedStream, escape


class StderrRelay:
    """File descriptor 2, escaped while the block runs: a panic in a thread of Zenoh is written there.

    Text of Python goes directly to standard error, which preserves its order and shows if it is a terminal.
    """

    JOIN_S = 0.5
    """the time to wait for data still in the pipe [s]; a child process may hold the other end for longer"""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._real = -1

    def __enter__(self) -> StderrRelay:
        with contextlib.ExitStack() as undo:
            try:
                sys.stderr.flush()
                self._real = os.dup(2)
                undo.callback(os.close, self._real)
                reads, writes = os.pipe()
                undo.callback(os.close, reads)
                undo.callback(os.close, writes)
                thread = threading.Thread(target=self._relay, args=(reads,), name="stderr", daemon=True)
                stream = open(self._real, "w", encoding=sys.stderr.encoding, errors="backslashreplace", closefd=False)
                thread.start()
            except (OSError, RuntimeError, ValueError, AttributeError):
                return self  # it only helps
            undo.pop_all()
        os.dup2(writes, 2)
        os.close(writes)
        self._before, self._thread, sys.stderr = sys.stderr, thread, EscapedStream(stream)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None:
            return
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()
        os.dup2(self._real, 2)
        sys.stderr = self._before
        self._thread.join(self.JOIN_S)

    def _relay(self, reads: int) -> None:
        decode = codecs.getincrementaldecoder("utf-8")("replace").decode
        while data := os.read(reads, 2**16):
            with contextlib.suppress(OSError):  # it has no reader
                os.write(self._real, escape(decode(data)).encode(errors="backslashreplace"))
