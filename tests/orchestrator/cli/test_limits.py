"""Limits and shells of real machines: too few processes, a terminal that closes, the environment of a notebook."""

from __future__ import annotations

import ctypes
import fcntl
import os
import pty
import resource
import select
import struct
import subprocess
import termios
from pathlib import Path

import psutil
import pytest

from hedgerow.topologies.errors import Exit
from tests.tools.processes import COMMAND, DEADLINE_S

NOTEBOOK = {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
UP = ("--viewer", "none", "--no-record")

UNUSED = 61_234
"""a user id that nothing else has"""


def as_another_user(user: int) -> None:
    """Become a user with limits that keeps the right to read the files of root, where the environment may lie."""
    libc = ctypes.CDLL(None)
    keep_caps, ambient, raise_it, dac_override, search = 8, 47, 2, 1, 2
    libc.prctl(keep_caps, 1, 0, 0, 0)
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
    caps = 1 << dac_override | 1 << search
    head, data = struct.pack("=Ii", 0x20080522, 0), struct.pack("=6I", caps, caps, caps, 0, 0, 0)
    libc.capset(head, data)
    for one in (dac_override, search):
        libc.prctl(ambient, raise_it, one, 0, 0)


def run(*arguments: str, more: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S * 3,
        check=False,
        env=os.environ | (more or {}),
    )


@pytest.mark.slow
def test_a_report_and_a_sweep_from_a_notebook(here: Path) -> None:
    """The backend that a notebook sets exists only in its own interpreter."""
    assert run("simulate", "paper7", "--steps", "5", "--no-record", "--run-dir", "run").returncode == Exit.VALID
    done = run("report", "run", "--figures", "gain", "--out", "report", more=NOTEBOOK)
    assert done.returncode == Exit.VALID, done.stderr
    assert list((here / "report").glob("*.png"))
    done = run("sweep", "paper7", "--seeds", "0:2", "--set", "steps=5", "--out", "swept", "--jobs", "1", more=NOTEBOOK)
    assert done.returncode == Exit.VALID, done.stdout + done.stderr
    assert (here / "swept/sweep.parquet").is_file()


@pytest.mark.slow
def test_too_few_processes_are_named_in_one_line(here: Path) -> None:
    """As with `ulimit -u`: the limit counts all processes and threads of the user, and none of them holds for root."""
    user = os.getuid() or UNUSED
    mine = [one for one in psutil.process_iter(["uids"]) if one.info["uids"] and one.info["uids"].real == user]
    most = sum(one.num_threads() for one in mine) + 60

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_NPROC, (most, most))
        if os.getuid() == 0:
            as_another_user(user)

    os.chmod(here, 0o777)
    done = subprocess.run(
        [*COMMAND, "up", "grid16", *UP],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
        preexec_fn=limited,
    )
    assert done.returncode == Exit.UNKNOWN
    assert "ulimit -u" in done.stdout.splitlines()[-1]
    assert "Traceback" not in done.stdout + done.stderr


@pytest.mark.slow
def test_a_terminal_that_closes_under_a_viewer_is_no_mistake_of_the_users(here: Path) -> None:
    """SIGHUP, and every write to the terminal fails: the run is stopped, and its verdict is there."""
    leader, terminal = pty.openpty()
    command = [*COMMAND, "up", "paper7", "--steps", "100000", "--rate", "50", "--viewer", "web", "--run-dir", "run"]
    with subprocess.Popen(
        command, stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509
    ) as up:  # fmt: skip
        os.close(terminal)
        printed, events = b"", here / "run/events.jsonl"
        while not (events.exists() and "first_step" in events.read_text()):
            printed += os.read(leader, 4096) if select.select([leader], [], [], 0.05)[0] else b""
            assert up.poll() is None, printed
        os.close(leader)
        assert up.wait(DEADLINE_S) == Exit.UNKNOWN
    assert (here / "run/verdict.json").is_file()
