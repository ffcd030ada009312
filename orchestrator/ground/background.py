"""A thread for jobs beside the loop; it has a lower priority than the other threads."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable

from hedgerow.orchestrator.ground.bounded_queue import BoundedQueue
from hedgerow.topologies.errors import DeadlineError

Job = Callable[[], None]

WAITING, WAITING_BYTES = 4, 2**27
"""Limits on the number and size of waiting jobs, at least one; a caller with one more waits."""
CHECK_S = 0.2
"""The time between two checks of a waiting caller whether a job stalls."""
NICE = 3
"""Half of the share of other threads. A lower priority would delay a thread that waits for Python's lock."""


class BackgroundThread:
    """A thread that does jobs in the order of their arrival.

    The first error ends the jobs: `failed` is called with it once, on this thread. A job that takes longer than
    `stalls_s` is such an error, a DeadlineError; the caller that waits for the job then calls `failed`.
    """

    def __init__(self, name: str, failed: Callable[[BaseException], object], stalls_s: float | None = None) -> None:
        self._jobs: BoundedQueue[Job] = BoundedQueue(WAITING, WAITING_BYTES)
        self._failed = failed
        self._over = self._stalled = False
        self._lock = threading.Lock()
        self._name, self._stalls_s = name, stalls_s
        self._began: float | None = None
        """the time when the current job began"""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Job, size: int = 0) -> None:
        """Queue a job that needs this memory [bytes]."""
        while not self._over and not self._jobs.put(job, size, CHECK_S):
            self._check()

    def close(self) -> None:
        """Wait until all jobs are done, or one has stalled."""
        self._jobs.close()
        while self._thread.is_alive() and not self._stalled:
            self._thread.join(CHECK_S)
            self._check()

    def _check(self) -> None:
        """End the jobs if the current one stalls: a job that never returns must not hold the caller."""
        began = self._began
        if self._stalls_s is None or began is None or (took := time.monotonic() - began) <= self._stalls_s:
            return
        self._stalled = True
        self._end(DeadlineError(f"{self._name} did not answer for {took:.0f} s"))

    def _end(self, error: BaseException) -> None:
        with self._lock:
            over, self._over = self._over, True
        if not over:
            self._failed(error)

    def _run(self) -> None:
        if sys.platform == "linux":  # on other systems, all threads of a process have one priority
            with contextlib.suppress(OSError):  # a container may forbid it
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
                me = threading.get_native_id()
                os.setpriority(os.PRIO_PROCESS, me, os.getpriority(os.PRIO_PROCESS, me) + NICE)
        while (taken := self._jobs.take()) is not None:
            if self._over:
                continue
            self._began = time.monotonic()
            try:
                taken[0]()
            except BaseException as error:  # a panic of a Rust library is not an Exception
                self._end(error)
            self._began = None
