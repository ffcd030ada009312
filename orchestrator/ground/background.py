"""A thread for jobs beside the loop; it has a lower priority than the other threads."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable

Job = Callable[[], None]

WAITING, WAITING_BYTES = 4, 2**27
"""The maximum number and size of waiting jobs; one job is always accepted, and a caller with more must wait."""
NICE = 3
"""Half of the share of other threads. A lower priority would delay a thread that waits for Python's lock."""


class BackgroundThread:
    """A thread that does jobs in the order of their arrival.

    An error ends the jobs, and is passed to `failed` on this thread.
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
        """Queue a job that needs this memory [bytes]."""
        self._put(job, size)

    def close(self) -> None:
        """Wait until all jobs are done."""
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
        if sys.platform == "linux":  # on other systems, all threads of a process have one priority
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (job := self._take()) is not None:
            if not self._over:
                try:
                    job()
                except BaseException as error:  # a panic of a Rust library is not an Exception
                    self._over = True
                    self._failed(error)
