"""Ctrl-C and similar signals: the first ends a run cleanly, the second ends it at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

from hedgerow.topologies.errors import HedgerowError
from hedgerow.wire import start

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class EndNowError(HedgerowError):
    """The end that the user asked for, by a signal."""


class Interrupts:
    """A counter of signals that ask for the end while the block runs; the second raises EndNowError in the main thread.

    A signal that was ignored before the block stays ignored: SIGHUP under nohup, SIGINT in a background job.
    """

    def __init__(self, notify: Callable[[], None] = lambda: None) -> None:
        self._notify = notify
        self._before: dict[int, Any] = {}
        self.count = 0
        self.name = ""

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: start.handle(number, self._take) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            if before is not signal.SIG_IGN:
                signal.signal(number, before)

    def _take(self, number: int, _: FrameType | None) -> None:
        self.count += 1
        self.name = start.name_of(number)
        if self.count == 2:
            raise EndNowError(f"a second {self.name}")
        self._notify()
