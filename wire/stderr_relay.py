"""File descriptor 2 of a command, escaped on its way to the terminal."""

from __future__ import annotations

import codecs
import contextlib
import gc
import os
import re
import signal
import sys
import time
from types import TracebackType
from typing import NoReturn

from hedgerow.topologies.escape import EscapedStream, escape

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
"""Libraries colour their lines also for what is no terminal."""


class StderrRelay:
    """File descriptor 2, escaped while the block runs: a panic in a thread of Zenoh is written there.

    A second process reads it, because the last message of a library that aborts this process must arrive too. Enter
    the block before this process has threads. Text of Python goes directly to standard error, which preserves its order
    and shows if it is a terminal.
    """

    WAIT_S = 0.5
    """seconds to wait for what is still in the pipe; a child process may hold its other end for longer"""

    def __init__(self) -> None:
        self._pid = 0
        self._real = -1

    def __enter__(self) -> StderrRelay:
        with contextlib.ExitStack() as undo:
            try:
                sys.stderr.flush()
                sys.stdout.flush()  # else the new process would hold the same text
                self._real = os.dup(2)
                undo.callback(os.close, self._real)
                reads, writes = os.pipe()
                undo.callback(os.close, writes)
                undo.callback(os.close, reads)
                stream = open(self._real, "w", encoding=sys.stderr.encoding, errors="backslashreplace", closefd=False)
                self._pid = os.fork()
            except (OSError, ValueError, AttributeError):
                return self  # it only helps
            undo.pop_all()
        if not self._pid:
            _relay(reads, self._real)
        os.close(reads)
        os.dup2(writes, 2)
        os.close(writes)
        self._before, sys.stderr = sys.stderr, EscapedStream(stream)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._pid:
            return
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()
        os.dup2(self._real, 2)
        sys.stderr = self._before
        until = time.monotonic() + self.WAIT_S
        with contextlib.suppress(OSError):
            while os.waitpid(self._pid, os.WNOHANG)[0] == 0 and time.monotonic() < until:
                time.sleep(0.001)


def _relay(reads: int, real: int) -> NoReturn:
    """Copy the pipe to standard error as the whole of this process, until no process holds its other end."""
    try:
        gc.disable()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGPIPE):
            signal.signal(number, signal.SIG_IGN)
        os.dup2(reads, 0)
        os.dup2(real, 1)
        os.closerange(2, 64)
        decode = codecs.getincrementaldecoder("utf-8")("replace").decode
        while data := os.read(0, 2**16):
            with contextlib.suppress(OSError):  # it has no reader
                os.write(1, escape(_COLOUR.sub("", decode(data))).encode(errors="backslashreplace"))
    finally:
        os._exit(0)
