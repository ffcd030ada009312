"""A job of a background thread that fails or never returns does not block its caller."""

import os
import queue
import sys
import threading

import pytest

from hedgerow.orchestrator.ground.background import NICE, WAITING, BackgroundThread
from hedgerow.topologies.errors import DeadlineError


def waits(event: threading.Event) -> None:
    event.wait()


def fails() -> None:
    raise ZeroDivisionError


def test_jobs_are_done_in_their_order_and_close_waits_for_them() -> None:
    done: list[int] = []
    thread = BackgroundThread("jobs", lambda error: pytest.fail(str(error)))
    for number in range(3 * WAITING):
        thread.do(lambda number=number: done.append(number))  # type: ignore[misc]
    thread.close()
    assert done == list(range(3 * WAITING))


def test_after_an_error_no_job_is_done_and_nobody_waits() -> None:
    failures: list[BaseException] = []
    thread = BackgroundThread("jobs", failures.append)
    thread.do(fails)
    for _ in range(3 * WAITING):
        thread.do(lambda: pytest.fail("it is done after an error"))
    thread.close()
    assert [type(error) for error in failures] == [ZeroDivisionError]


def test_a_job_that_never_returns_is_left_behind() -> None:
    failures: list[BaseException] = []
    thread, never = BackgroundThread("jobs", failures.append, stalls_s=0.1), threading.Event()
    for _ in range(3 * WAITING):
        thread.do(lambda: waits(never))
    thread.close()
    assert [type(error) for error in failures] == [DeadlineError]
    never.set()


def test_a_slow_job_is_waited_for() -> None:
    failures: list[BaseException] = []
    thread, done = BackgroundThread("jobs", failures.append, stalls_s=30.0), list[int]()

    def job() -> None:
        threading.Event().wait(0.3)
        done.append(1)

    thread.do(job)
    thread.close()
    assert (failures, done) == ([], [1])


@pytest.mark.skipif(sys.platform != "linux", reason="one priority per process")
def test_a_background_thread_has_a_lower_priority_than_its_process() -> None:
    """The priority is relative: a run that itself has a low or a high priority keeps the distance."""
    nice = queue.SimpleQueue[int]()
    thread = BackgroundThread("test", nice.put)  # type: ignore[arg-type]  # no error is expected
    thread.do(lambda: nice.put(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    thread.close()
    ours = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    assert nice.get(timeout=5.0) == min(ours + NICE, 19)
