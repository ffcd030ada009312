"""A watch of the law of a run in this process: it reports a call that does not end, with its line."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

from hedgerow.agents.law_lines import call_of, running

REPORT_AFTER_S = 8.0
"""the time of one call of a law after which the terminal reports it; the log of an agent names a slow law sooner,
after agents.process.PATIENCE_S"""
LOOK_EVERY_S = 1.0


class LawWatch:
    """A thread that reports one call of a law on the thread of its maker that takes longer than `REPORT_AFTER_S`.

    In a run of several processes, the deadline of the plant ends such a run. In one process there is no such deadline.
    """

    def __init__(self, law: type[Any], name: str, say: Callable[[str], None]) -> None:
        self._law, self._name, self._say = law, name, say
        self._watched = threading.get_ident()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="law watch", daemon=True)

    def __enter__(self) -> LawWatch:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        # The frame is held, because a frame that is freed and a new one may have the same address.
        call: FrameType | None = None
        since, reported = 0.0, False
        while not self._over.wait(LOOK_EVERY_S):
            now = call_of(self._watched, self._law)
            if now is not call:
                call, since, reported = now, time.monotonic(), False
            elif call is not None and not reported and (took := time.monotonic() - since) > REPORT_AFTER_S:
                where, reported = running(self._watched, self._law), True
                self._say(
                    f"{where}: law {self._name}: one call has been running for {took:.0f} s."
                    " Make the law end, or press Ctrl-C twice to end the run."
                )
