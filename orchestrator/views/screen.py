"""What a person, a log or a machine sees of a run while it goes on."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable
from errno import EIO
from pathlib import Path
from typing import Protocol

from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.topologies.escape import command, echo
from hedgerow.topologies.schema import Topology

LINE_EVERY_S = 2.0


class Outlet:
    """Standard output that a run goes on without: what is lost there is remembered, and raises nothing."""

    def __init__(self) -> None:
        self._terminal = _leads_to_terminal()
        self.lost: OSError | None = None
        """why something could not be written"""

    def write(self, put: Callable[[], object]) -> None:
        """Call `put`, which writes to standard output; after an error all output leads nowhere."""
        try:
            put()
        except OSError as error:
            self.lost = self.lost or error
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    @property
    def incomplete(self) -> OSError | None:
        """The error, unless the reader of a pipe has left or the terminal was closed: that reader has read enough."""
        closed = isinstance(self.lost, BrokenPipeError) or (self._terminal and getattr(self.lost, "errno", 0) == EIO)
        return None if closed else self.lost


def _leads_to_terminal() -> bool:
    with contextlib.suppress(OSError, ValueError):
        return sys.stdout.isatty()
    return False


class Screen(Protocol):
    """Told of a run's course; says it in its own way."""

    interactive: bool
    """whether somebody sits before it"""
    outlet: Outlet
    """standard output, which a screen writes to"""

    def say(self, text: str) -> None:
        """Something that happened."""

    def progress(self, batch: Batch) -> None:
        """Some more steps are done."""

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        """The run is over."""

    def close(self) -> None:
        """Leave the terminal as it was, whether there was a verdict or not."""


def left_behind(folder: Path) -> str:
    """What a run leaves, and how it is looked at."""
    # The command stands beside our own interpreter, which need not be on the PATH.
    program = "orchestrator" if shutil.which("orchestrator") else Path(sys.executable).with_name("orchestrator")
    return f"run folder {folder}\nsee it again with: {command([program, 'open', folder])}"


class Lines:
    """Plain lines, for logs and pipes, and for terminals with --plain."""

    def __init__(self, steps: int, interactive: bool = False) -> None:
        self.interactive = interactive
        self._steps, self._said = steps, time.monotonic()
        self.outlet = Outlet()

    def say(self, text: str) -> None:
        self.outlet.write(lambda: echo(text))

    def progress(self, batch: Batch) -> None:
        now, done = time.monotonic(), int(batch.t[-1]) + 1
        if now - self._said >= LINE_EVERY_S:
            self._said = now
            self.say(
                f"step {done} of {self._steps}, regret D {batch.regret_sum[-1]:.4g}, {batch.right[-1]} estimates right"
            )

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        self.say(left_behind(folder))
        self.say(verdict.line())

    def close(self) -> None:
        pass


class Json:
    """One JSON object on standard output, when all is over; the rest goes to standard error."""

    interactive = False

    def __init__(self) -> None:
        self.outlet = Outlet()

    def say(self, text: str) -> None:
        with contextlib.suppress(OSError):
            echo(text, error=True)

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        text = json.dumps({"folder": str(folder), **verdict.content})
        self.outlet.write(lambda: echo(text))

    def close(self) -> None:
        pass


class Quiet:
    """Nothing at all."""

    interactive = False

    def __init__(self) -> None:
        self.outlet = Outlet()

    def say(self, text: str) -> None:
        pass

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        pass

    def close(self) -> None:
        pass


def screen(topology: Topology, as_json: bool, plain: bool = False, watched: bool = False) -> Screen:
    """The screen that fits where we run: on a terminal a live table, or a bar where a viewer shows more (`watched`)."""
    if as_json:
        return Json()
    terminal = sys.stdout.isatty()
    if not terminal or plain or os.environ.get("TERM", "").lower() in ("dumb", "unknown"):
        return Lines(topology.steps, terminal)
    from hedgerow.orchestrator.views.terminal import Bar, Table  # noqa: PLC0415 (rich takes a while to load, and pipes need none)

    return Bar(topology.steps) if watched else Table(topology)
