"""A killed pytest leaves no network behind, not even a detached one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.tools.leftovers import MARK, marked

STUCK = """
import os, pathlib, signal, subprocess, sys
from tests.tools.leftovers import MARK, nothing_lives_on

def test_that_never_ends():
    up = [sys.executable, "-P", "-m", "hedgerow.orchestrator", "up", "paper7", "--detach"]
    subprocess.run([*up, "--rate", "10", "--steps", "100000", "--viewer", "none", "--no-record"], check=True)
    pathlib.Path("mark.part").write_text(os.environ[MARK])
    pathlib.Path("mark.part").rename("mark")
    signal.pause()
"""
ALL_OF_PAPER7 = 1 + 1 + 1 + 7
"""the command, its fork server, the plant and the agents"""


def wait_until(true: Callable[[], bool], within_s: float = 60.0) -> None:
    until, pause = time.monotonic() + within_s, threading.Event()
    while not true():
        assert time.monotonic() < until
        pause.wait(0.02)


@pytest.mark.slow
def test_a_network_in_the_background_ends_with_the_pytest_that_started_it(here: Path) -> None:
    (here / "test_stuck.py").write_text(STUCK)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_stuck.py"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        wait_until(lambda: (here / "mark").exists() or process.poll() is not None)
        mark = (here / "mark").read_text()
        assert mark != os.environ[MARK]
        assert len(marked(mark)) == ALL_OF_PAPER7
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    wait_until(lambda: not marked(mark))
