"""Processes of tests end with pytest, even if that is killed or stuck; this includes detached networks.

A watcher holds on to pytest by a pipe. When that closes, it ends every process that has inherited this session's mark.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import uuid
from collections.abc import Iterator

import psutil
import pytest

MARK = "HEDGEROW_TESTS"


@pytest.fixture(scope="session", autouse=True)
def nothing_lives_on() -> Iterator[None]:
    """The processes of this session are marked, and watched."""
    mark = uuid.uuid4().hex
    watcher = subprocess.Popen(
        [sys.executable, __file__, mark],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # a signal to pytest's process group does not end it
    )
    os.environ[MARK] = mark
    yield
    del os.environ[MARK]
    watcher.communicate()


def marked(mark: str) -> list[psutil.Process]:
    """Processes that run with this mark in their environment."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def main() -> None:
    """Wait for the end of standard input; then end all processes with the mark, and their new children."""
    sys.stdin.buffer.read()
    while left := marked(sys.argv[1]):
        for process in left:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(left, timeout=1)


if __name__ == "__main__":
    main()
