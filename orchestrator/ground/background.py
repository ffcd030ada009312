"""A thread for jobs beside the loop; it has a lower priority than the other threads."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

from hedgerow.topologies.errors import DeadlineError

Job = Callable[[], None]

WAITING, WAITING_BYTES = 4, 2**27
"""Limits on the number and size of waiting jobs, at least one; a caller with one more waits."""
CHECK_S = 0.2
"""The time between two checks of a waiting caller for a stalled job [s]."""
NICE = 3
"""Half of the share of other threads. A lower priority would delay a thread that waits for Python's lock."""


class BackgroundThread:
    """A thread that does jobs in the order of their arrival.

    After an error no job is done any more, and `failed` has been called with it, on this thread. A job that takes
    longer than `stalls_s` is such an error, of which the caller that waits for it calls `failed`.
    """

    def __init__(self, name: str, failed: Callable[[BaseException], object], stalls_s: float | None = None) -> None:
        self._jobs: deque[tuple[Job | None, int]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._failed = failed
        self._over = self._stalled = self._ended = False
        self._name, self._stalls_s = name, stalls_s
        self._began: float | None = None
        """when the job that is done now began"""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Job, size: int = 0) -> None:
        """Queue a job that needs this memory [bytes]."""
        self._put(job, size)

    def close(self) -> None:
        """Return when all is done, or a job has stalled."""
        self._put(None, 0)
        self._wait_for(lambda: self._ended)

    def _wait_for(self, is_true: Callable[[], bool]) -> None:
        """Wait until `is_true`, or until a job has stalled: a job that never returns must not hold the caller."""
        while True:
            with self._changed:
                if self._stalled or self._changed.wait_for(is_true, CHECK_S):
                    return
                took = time.monotonic() - (self._began or time.monotonic())
                if self._stalls_s is None or took <= self._stalls_s:
                    continue
                self._stalled = True
                told, self._over = self._over, True
            if not told:
                self._failed(DeadlineError(f"{self._name} did not answer for {took:.0f} s"))

    def _put(self, job: Job | None, size: int) -> None:
        def room() -> bool:
            return not self._jobs or (len(self._jobs) < WAITING and self._bytes + size <= WAITING_BYTES)

        self._wait_for(room)
        with self._changed:
            if self._over and job is not None:
                return  # it would never be done
            self._jobs.append((job, size))
            self._bytes += size
            self._changed.notify_all()

    def _take(self) -> Job | None:
        with self._changed:
            self._changed.wait_for(lambda: self._jobs)
            job, size = self._jobs.popleft()
            self._bytes -= size
            self._began = time.monotonic()
            self._changed.notify_all()
        return job

    def _run(self) -> None:
        if sys.platform == "linux":  # elsewhere all threads of a process are as nice
            with contextlib.suppress(OSError):  # a container may forbid it
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (job := self._take()) is not None:
            if not self._over:
                try:
                    job()
                except BaseException as error:  # a panic of a Rust library is no Exception
                    with self._changed:
                        told, self._over = self._over, True
                    if not told:  # else a caller has called `failed`
                        self._failed(error)
            self._began = None
        with self._changed:
            self._ended = True
            self._changed.notify_all()
