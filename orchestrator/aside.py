"""A thread for what a loop need not wait for, and which leaves the processor to whoever else wants it."""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Callable

Job = Callable[[], None]

WAITING = 4
"""jobs that may wait; whoever hands over one more waits too"""
NICE = 3
"""half of the share of others, not nothing: whoever waits for Python's lock waits for this thread"""


class Aside:
    """Does jobs in the order in which they come.

    An error is raised to whoever hands over the next job, or closes; nothing is done after it.
    """

    def __init__(self, name: str) -> None:
        self._jobs: queue.Queue[Job | None] = queue.Queue(WAITING)
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Job) -> None:
        """Hand over a job."""
        self._raise()
        self._jobs.put(job)

    def close(self) -> None:
        """Return when all is done."""
        self._jobs.put(None)
        self._thread.join()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        if sys.platform == "linux":  # elsewhere all threads of a process are as nice
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (job := self._jobs.get()) is not None:
            if self._error is None:
                try:
                    job()
                except Exception as error:  # it belongs to whoever wanted the job done
                    self._error = error
