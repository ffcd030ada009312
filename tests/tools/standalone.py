"""Agents and plants that a run did not start; each has the file of `orchestrator bundle`, as on another machine."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import pytest

from tests.tools import preloaded
from tests.tools.processes import DEADLINE_S, orchestrator

UP = ("--viewer", "none", "--no-record", "--verify")


class Started:
    """A process of a run that `up` did not start; the end of the block kills it if it still runs."""

    def __init__(self, module: str, *arguments: str) -> None:
        """`module` is `agents` or `plant`."""
        reads, writes = os.pipe()
        self._log = open(reads, encoding="utf-8")  # noqa: SIM115 (the end of the block closes it)
        self._process = preloaded.SESSION.start(arguments, (0, 1, writes), module=f"hedgerow.{module}.standalone")
        os.close(writes)

    def wait(self) -> tuple[int, str]:
        """Its exit code and its log, once it has ended."""
        late = threading.Timer(DEADLINE_S, self._process.kill)
        late.start()
        printed = self._log.read()
        late.cancel()
        return self._process.wait(DEADLINE_S), printed

    def wait_for(self, text: str) -> None:
        """Read its log until this text."""
        assert any(text in line for line in self._log), text

    def poll(self) -> int | None:
        """Return its exit code if it has ended."""
        return self._process.poll()

    def send(self, number: int) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def kill(self) -> None:
        """Send it SIGKILL."""
        self.send(signal.SIGKILL)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(DEADLINE_S)
        self._log.close()


@pytest.fixture
def start() -> Iterator[Any]:
    """Start agents and plants; those that still run at the end are killed."""
    with contextlib.ExitStack() as stack:
        yield lambda module, *arguments: stack.enter_context(Started(module, *arguments))


@pytest.fixture
def endpoint(here: Path) -> str:
    """Where a run is reached: a socket, so that tests never meet on a port."""
    return f"unixsock-stream/{here}/lab.sock"


def bundle(endpoint: str, *arguments: str) -> None:
    """Write the files of the processes of paper7 to the folder lab."""
    done = orchestrator("bundle", "paper7", "--out", "lab", "--router", endpoint, *arguments)
    assert done.returncode == 0, done.stderr
