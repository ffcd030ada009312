"""A thread for jobs that the loop does not wait for; it yields the processor to other threads."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable

Job = Callable[[], None]

WAITING, WAITING_BYTES = 4, 2**27
"""Limits on the number and size of waiting jobs, at least one; a caller with one more waits."""
NICE = 3
"""Half of the share of other threads. More would delay a thread that waits for Python's lock."""


class BackgroundThread:
    """Does jobs in the order in which they come.

    After an error no job is done any more, and `failed` has been called with it, on this thread.
    """

    def __init__(self, name: str, failed: Callable[[BaseException], object]) -> None:
        self._jobs: deque[tuple[Job | None, int]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._failed = failed
        self._over = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Job, size: int = 0) -> None:
        """Hand over a job that holds on to so many bytes."""
        self._put(job, size)

    def close(self) -> None:
        """Return when all is done."""
        self._put(None, 0)
        self._thread.join()

    def _put(self, job: Job | None, size: int) -> None:
        def room() -> bool:
            return not self._jobs or (len(self._jobs) < WAITING and self._bytes + size <= WAITING_BYTES)

        with self._changed:
            self._changed.wait_for(room)
            self._jobs.append((job, size))
            self._bytes += size
            self._changed.notify_all()

    def _take(self) -> Job | None:
        with self._changed:
            self._changed.wait_for(lambda: self._jobs)
            job, size = self._jobs.popleft()
            self._bytes -= size
            self._changed.notify_all()
        return job

    def _run(self) -> None:
        if sys.platform == "linux":  # elsewhere all threads of a process are as nice
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (job := self._take()) is not None:
            if not self._over:
                try:
                    job()
                except BaseException as error:  # a panic of a Rust library is no Exception
                    self._over = True
                    self._failed(error)
