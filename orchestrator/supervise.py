"""The processes of a run: started with what they are told, watched, and gone when we are."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.view import View
from orchestrator.folder import RunFolder
from plant.truth import Truth
from topologies.errors import HedgerowError, UserError
from wire import keys
from wire.child import ERROR_PREFIX
from wire.session import runtime_environment

MAX_SOCKET_PATH = 100
"""Bytes; the kernel's limit for a Unix socket is 108 with its end."""


class ProcessError(HedgerowError):
    """A process of the run ended when it should not have."""


@dataclass(frozen=True)
class Dead:
    """A process that ended: its name, how, and the error that its log ends with (empty when it says none)."""

    name: str
    code: int
    error: str

    def __str__(self) -> str:
        how = f"was killed by {signal.Signals(-self.code).name}" if self.code < 0 else f"ended with code {self.code}"
        return f"{self.name} {how}" + (f": {self.error}" if self.error else "")


def socket_path(folder: RunFolder) -> Path:
    """Where the router listens: in the run's folder, or in a private one when that path is too long for a socket."""
    if len(os.fsencode(folder.socket)) <= MAX_SOCKET_PATH:
        return folder.socket
    return Path(tempfile.mkdtemp(prefix="hedgerow-")) / "router.sock"


class Processes:
    """The plant and the agents, each a process of its own with a log of its own."""

    def __init__(self, folder: RunFolder, namespace: str, endpoint: str) -> None:
        self._folder = folder
        self._wire = ["--namespace", namespace, "--connect", endpoint]
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._environment = os.environ | runtime_environment() | {"PYTHONUNBUFFERED": "1"}

    def start_agent(self, view: View) -> None:
        """Launch one shard with its local view and nothing else."""
        name = f"agent-{view.nodes[0].id}" if len(view.nodes) == 1 else f"shard-{view.shard}"
        self._start(name, "agents", view.to_json(), [])

    def start_plant(self, truth: Truth, rate: float, deadline_s: float, socket: Path | None, listed: Path) -> None:
        """Launch the plant; should we die, it removes our router's `socket` and our entry among running networks."""
        options = ["--rate", str(rate), "--deadline", str(deadline_s), "--listed", str(listed)]
        self._start(keys.PLANT, "plant", truth.to_json(), [*options, *(["--socket", str(socket)] if socket else [])])

    def _start(self, name: str, module: str, told: str, options: Sequence[str]) -> None:
        file = self._folder.processes / f"{name}.json"
        file.write_text(told, encoding="utf-8")
        # -P: a folder called `agents` in the user's working directory is not ours.
        command = [sys.executable, "-P", "-m", module, str(file), *self._wire, *options]
        with (self._folder.logs / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,  # the lifeline: see wire.child
                stdout=log,
                stderr=log,
                env=self._environment,
                start_new_session=True,  # a Ctrl-C in the terminal is ours to handle
            )

    @property
    def pids(self) -> dict[str, int]:
        """The process id of everyone started, by name."""
        return {name: process.pid for name, process in self._running.items()}

    def dead(self) -> list[Dead]:
        """Who has ended so far, other than in good order."""
        codes = {name: process.poll() for name, process in self._running.items()}
        return [Dead(name, code, self._last_error(name)) for name, code in codes.items() if code]

    def ended(self, name: str) -> bool:
        """Whether that process is gone, in good order or not."""
        return self._running[name].poll() is not None

    def _last_error(self, name: str) -> str:
        try:
            lines = (self._folder.logs / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return ""
        errors = [line for line in lines if line.startswith(ERROR_PREFIX)]
        return errors[-1].removeprefix(ERROR_PREFIX) if errors else ""

    def wait(self, timeout_s: float) -> list[str]:
        """Wait for all to end by themselves; return the names of those that have not."""
        deadline = time.monotonic() + timeout_s
        for process in self._running.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                break
        return [name for name, process in self._running.items() if process.poll() is None]

    def kill(self) -> None:
        """End whoever is still there, at once; return when all are gone."""
        for process in self._running.values():
            if process.poll() is None:
                process.kill()
        for process in self._running.values():
            process.wait()
            if process.stdin is not None:
                process.stdin.close()


def cause(dead: Sequence[Dead]) -> HedgerowError:
    """What to tell the user about processes that died: a mistake of theirs if one says so, else what happened."""
    mistakes = [one for one in dead if one.code == 2 and one.error]
    if mistakes:
        return UserError(mistakes[0].error)
    others = f" (and {len(dead) - 1} more: {', '.join(one.name for one in dead[1:8])})" if len(dead) > 1 else ""
    return ProcessError(f"{dead[0]}{others}")
