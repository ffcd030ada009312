"""Processes that outlive the command that starts them, or end with the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from hedgerow.topologies.escape import echo
from hedgerow.wire import start


def end_with_standard_input() -> None:
    """Wait for the end of standard input, then end this process by a signal.

    The process that started this one holds the other end of the pipe, and releases it even when SIGKILL ends it.
    """
    while os.read(0, 4096):
        pass
    # The kernel drops an ignored signal: send one that this process does not ignore.
    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    os.kill(os.getpid(), next((one for one in numbers if not start.ignored([one])), signal.SIGKILL))


_VARIABLE = "HEDGEROW_DETACHED"
_END_DEADLINE_S = 30.0
"""The time for a network to end after Ctrl-C during its start [s]."""


def start_detached() -> int:
    """Run the same command in a separate session, and return the exit code."""
    asked: list[int] = []
    process = None

    def end(number: int, _: object) -> None:
        asked.append(number)
        if process is not None:
            process.terminate()
            threading.Thread(target=_kill_later, args=(process,), daemon=True).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        start.handle(number, end)
    command = [
        sys.executable,
        "-P",
        "-m",
        "hedgerow.orchestrator",
        *(word for word in sys.argv[1:] if word != "--detach"),
    ]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env=os.environ | {_VARIABLE: "1"},
    )
    if asked:  # a signal arrived during Popen
        end(asked[0], None)
    assert process.stdout is not None
    for line in process.stdout:
        echo(line.decode(errors="replace"), end="")
    try:
        code = process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        code = 0
    if asked:
        process.wait()
        code = 128 + asked[0]
    return code


def _kill_later(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_END_DEADLINE_S)
    except subprocess.TimeoutExpired:
        process.kill()


def release_terminal(log: Path) -> None:
    """Redirect standard output and error of this process to a log, so that the terminal is free."""
    sys.stdout.flush()
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(descriptor, 1)
    # Do not redirect descriptor 2: the output of libraries on it is escaped on its way to this one
    # (wire/stderr_relay.py).
    os.dup2(descriptor, sys.stderr.fileno())


def is_detached() -> bool:
    """Return True if `start_detached` of another process started this one."""
    return bool(os.environ.get(_VARIABLE))
