"""The client of the fork server: it orders new processes, and learns which processes run and which ended.

It starts first of all in a command, so the server loads in parallel: this module imports nothing heavy.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hedgerow.topologies.errors import DeadlineError
from hedgerow.wire import start
from hedgerow.wire.runtime import runtime_environment

FORK_DEADLINE_S = 30.0
END_DEADLINE_S = 5.0


def _leave_ctrl_c_to_us() -> None:
    """Ignore signals in the fork server, which ends with this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Order(NamedTuple):
    """An order for a process that runs `python -m MODULE ARGUMENTS` and logs to `log`."""

    name: str
    module: str
    arguments: Sequence[str]
    log: Path


class ForkClient:
    """The client of `hedgerow.orchestrator.launch.fork_server`, with its processes and their ends."""

    def __init__(self) -> None:
        held, self._lifeline = socket.socketpair()
        # -P ignores a folder `agents` in the user's working directory.
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "hedgerow.orchestrator.launch.fork_server",
                str(held.fileno()),
                *self._ignored(),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(held.fileno(),),
            env=os.environ | runtime_environment() | {"PYTHONUNBUFFERED": "1"},
            start_new_session=True,
            preexec_fn=_leave_ctrl_c_to_us,  # noqa: PLW1509 (a system call, no lock)
        )
        held.close()
        self.pid = self._process.pid
        self.pids: dict[str, int] = {}
        self.codes: dict[str, int] = {}
        self.on_end: Callable[[], None] = lambda: None
        """called at the end of a process, on a thread of this object"""
        self.error = ""
        """The last error text of the fork server."""
        self._closing = False
        self._changed = threading.Condition()
        self._listener = threading.Thread(target=self._listen, name="fork server", daemon=True)
        self._listener.start()

    @staticmethod
    def _ignored() -> list[str]:
        """Return the argument that makes the children ignore SIGINT, if this process does."""
        return ["--ignore-sigint"] if start.ignored([signal.SIGINT]) else []

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            report = json.loads(line)
            if "error" in report:
                self.error = report["error"]
                continue
            with self._changed:
                (self.pids if "pid" in report else self.codes)[report["name"]] = report.get("pid", report.get("code"))
                self._changed.notify_all()
            if "code" in report:
                self.on_end()
        with self._changed:
            if not self._closing:
                self.codes["fork server"] = self._process.wait() or 1
            self._changed.notify_all()
        self.on_end()

    def fork(self, *orders: Order) -> None:
        """Start a process for each order."""
        with self._changed:
            for order in orders:
                self.pids.pop(order.name, None)
                self.codes.pop(order.name, None)
        self._tell(*(order._asdict() for order in orders))

    def leave_no(self, paths: Sequence[Path]) -> None:
        """Remove these files and folders when the fork server ends; it ends with its processes if this process dies."""
        self._tell({"leave": paths})

    def _tell(self, *requests: Mapping[str, object]) -> None:
        """Send requests, which the fork server reads together if the pipe has room for them."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # `codes` records its end
            self._process.stdin.write(b"".join(json.dumps(one, default=str).encode() + b"\n" for one in requests))
            self._process.stdin.flush()

    def wait_until_forked(self, names: Sequence[str]) -> None:
        """Wait until all of them run; raise DeadlineError after the deadline."""
        with self._changed:
            ok = self._changed.wait_for(lambda: set(names) <= self.pids.keys() or self.codes, FORK_DEADLINE_S)
        if not ok:
            raise DeadlineError(f"no process for {names[0]} after {FORK_DEADLINE_S:g} s")

    def kill(self, name: str) -> None:
        """Kill a process, if it runs."""
        with self._changed:
            pid = self.pids.get(name) if name not in self.codes else None
        if pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def wait(self, names: Iterable[str], timeout_s: float) -> None:
        """Wait up to `timeout_s` until the forked ones of these processes have ended."""
        with self._changed:
            self._changed.wait_for(
                lambda: "fork server" in self.codes or self.pids.keys() & names <= self.codes.keys(), timeout_s
            )

    def clear(self) -> None:
        """Kill the remaining processes, and return when all are gone."""
        with self._changed:
            left = self.pids.keys() - self.codes.keys()
        for name in left:
            self.kill(name)
        if "fork server" in self.codes:
            self._let_go()
        elif left:
            self.wait(left, END_DEADLINE_S)
        with self._changed:
            self.pids.clear()
            self.codes.clear()

    def close(self) -> None:
        """Kill the remaining processes, and then end the fork server."""
        self._closing = True  # do not report its own end
        self.clear()
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:  # it was frozen
            self._process.kill()
            self._process.wait()
        self._listener.join()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._let_go()
        self._lifeline.close()

    def _let_go(self) -> None:
        """Close the lifeline, which ends every process that holds its other end; wait until all have ended."""
        with contextlib.suppress(OSError):
            self._lifeline.settimeout(END_DEADLINE_S)
            self._lifeline.shutdown(socket.SHUT_WR)
            self._lifeline.recv(1)
