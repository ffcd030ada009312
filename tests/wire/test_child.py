"""A process of a run ends on request, at any moment."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.tools.processes import DEADLINE_S

STUCK = """
import ctypes
from hedgerow.wire.child import run_alone

def wait_for_good():  # in a call that no signal interrupts, and that lets other threads live
    library, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(64)
    library.pthread_mutex_lock(mutex)
    print("stuck", flush=True)
    library.pthread_mutex_lock(mutex)

run_alone(wait_for_good)
"""

DEAF = """
from hedgerow.wire.child import run_alone, stopped_by
from threading import Event

def end_in_good_order():
    print("stopping", flush=True)
    Event().wait()

def wait_to_be_told():
    with stopped_by(end_in_good_order):
        print("in", flush=True)
        Event().wait()

run_alone(wait_to_be_told)
"""

LOUD = """
import os, sys
from hedgerow.wire.child import run_alone

def fill_the_pipe_and_write():
    os.set_blocking(sys.stderr.fileno(), False)
    try:
        while os.write(sys.stderr.fileno(), b"loud"):
            pass
    except BlockingIOError:
        os.set_blocking(sys.stderr.fileno(), True)
    print("full", flush=True)
    print("loud", file=sys.stderr)

run_alone(fill_the_pipe_and_write)
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_process_with_a_blocked_main_thread(number: int, code: int) -> None:
    with subprocess.Popen([sys.executable, "-c", STUCK], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "stuck\n"
            process.send_signal(number)
            assert process.wait(DEADLINE_S) == code
        finally:
            process.kill()


def test_a_second_signal_ends_a_process_that_hangs_while_it_ends_in_good_order() -> None:
    with subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "in\n"
            process.send_signal(signal.SIGTERM)
            assert process.stdout.readline() == "stopping\n"
            process.send_signal(signal.SIGINT)
            assert process.wait(DEADLINE_S) == 130
        finally:
            process.kill()


def test_a_process_that_hangs_in_a_full_pipe_ends_as_well() -> None:
    """No process reads its output."""
    command = [sys.executable, "-c", LOUD]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"full\n"
            process.terminate()
            assert process.wait(DEADLINE_S) == 143
        finally:
            process.kill()
