"""The processes of a run: started with what they are told, watched, and gone when we are."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.view import View
from orchestrator.folder import RunFolder
from orchestrator.nursery import Nursery
from plant.truth import Truth
from wire import keys
from wire.child import ERROR_PREFIX

MAX_SOCKET_PATH = 100
"""Bytes; the kernel's limit for a Unix socket is 108 with its end."""


@dataclass(frozen=True)
class Dead:
    """A process that ended: its name, how, and the error that its log ends with (empty when it says none)."""

    name: str
    code: int
    error: str

    def __str__(self) -> str:
        how = f"was killed by {signal.Signals(-self.code).name}" if self.code < 0 else f"ended with code {self.code}"
        return f"{self.name} {how}" + (f": {self.error}" if self.error else "")


def cause(dead: Sequence[Dead]) -> str:
    """What to tell the user about processes that died."""
    others = f" (and {len(dead) - 1} more: {', '.join(one.name for one in dead[1:8])})" if len(dead) > 1 else ""
    return f"{dead[0]}{others}"


def socket_path(folder: RunFolder) -> Path:
    """Where the router listens: in the run's folder, or in a private one when that path is too long for a socket."""
    if len(os.fsencode(folder.socket)) <= MAX_SOCKET_PATH:
        return folder.socket
    return Path(tempfile.mkdtemp(prefix="hedgerow-")) / "router.sock"


class Processes:
    """The plant and the agents of one run, each a process of its own with a log of its own."""

    def __init__(self, nursery: Nursery, folder: RunFolder, namespace: str, endpoint: str) -> None:
        self._nursery, self._folder = nursery, folder
        self._wire = ["--namespace", namespace, "--connect", endpoint]
        self._names: list[str] = []

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
        self._nursery.fork(name, module, [str(file), *self._wire, *options], self._folder.logs / f"{name}.log")
        self._names.append(name)

    def wait_until_started(self) -> dict[str, int]:
        """The process ids by name, once all run."""
        self._nursery.wait_until_forked(self._names)
        return dict(self._nursery.pids)

    def dead(self) -> list[Dead]:
        """Who has ended so far, other than in good order."""
        codes = dict(self._nursery.codes)
        return [Dead(name, code, self._last_error(name)) for name, code in codes.items() if code]

    def ended(self, name: str) -> bool:
        """Whether that process is gone, in good order or not."""
        return name in self._nursery.codes or "nursery" in self._nursery.codes

    def wait(self, timeout_s: float) -> None:
        """Wait for all to end by themselves, at most so long."""
        self._nursery.wait(timeout_s)

    def _last_error(self, name: str) -> str:
        try:
            lines = (self._folder.logs / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return ""
        errors = [line for line in lines if line.startswith(ERROR_PREFIX)]
        return errors[-1].removeprefix(ERROR_PREFIX) if errors else ""
