"""The output of a run on standard output: a live table, lines, JSON or the verdict alone."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from hedgerow.orchestrator.views.outlet import Outlet, left_behind
from hedgerow.topologies.escape import echo
from hedgerow.topologies.schema import Topology

if TYPE_CHECKING:
    from hedgerow.orchestrator.metrics.observer import Batch
    from hedgerow.orchestrator.metrics.verdict import Verdict

LINE_EVERY_S = 2.0


class Screen(Protocol):
    """The output of one run."""

    interactive: bool
    """True if standard output is a terminal."""
    outlet: Outlet
    """Standard output, which the screen writes to."""

    def say(self, text: str) -> None:
        """Print an event."""

    def progress(self, batch: Batch) -> None:
        """Show the progress after some more steps."""

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        """Print the verdict at the end of the run."""

    def close(self) -> None:
        """Restore the terminal, with or without a verdict."""


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


class Brief(Lines):
    """Only the verdict, for `--quiet`."""

    def say(self, text: str) -> None:
        pass

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:  # noqa: ARG002 (`-q` does not name it)
        self.outlet.write(lambda: echo(verdict.line()))


class Json:
    """One JSON object on standard output at the end; everything else goes to standard error."""

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
    """A screen without output."""

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


def screen(
    topology: Topology, as_json: bool, plain: bool = False, quiet: bool = False, watched: bool = False
) -> Screen:
    """Return the screen for the options and for standard output.

    A terminal gets a live table, or a progress bar if a viewer shows more (`watched`); a pipe gets lines.
    """
    if as_json:
        return Json()
    if quiet:
        return Brief(topology.steps)
    terminal = sys.stdout.isatty()
    if not terminal or plain or os.environ.get("TERM", "").lower() in ("dumb", "unknown"):
        return Lines(topology.steps, terminal)
    from hedgerow.orchestrator.views.terminal import Bar, Table  # noqa: PLC0415 (rich takes a while to load, and pipes need none)

    return Bar(topology.steps) if watched else Table(topology)
