"""The runs of a sweep as they finish, and their progress: a bar on a terminal, lines from time to time elsewhere."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Generator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hedgerow.orchestrator.experiments.sweep.folder import SweepFolder
from hedgerow.orchestrator.experiments.sweep.runs import Answer, Failure
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.topologies.escape import echo

LINE_EVERY_S = 10.0


class Lines:
    """The progress in logs and pipes."""

    def __init__(self, there: int, runs: int) -> None:
        self._there, self._done, self._runs = there, there, runs
        self._began = self._printed = time.monotonic()

    def advance(self, runs: int) -> None:
        """Add this number of finished runs."""
        self._done += runs
        if (now := time.monotonic()) - self._printed >= LINE_EVERY_S:
            self._printed = now
            rate = (self._done - self._there) / (now - self._began)
            echo(f"{self._done} of {self._runs} runs, {rate:.3g} runs/s")

    def close(self) -> None:
        """Do nothing: lines need no end."""


class Bar:
    """The progress on a terminal."""

    def __init__(self, there: int, runs: int, console: Console) -> None:
        self._bar = Progress(
            BarColumn(), MofNCompleteColumn(), TextColumn("runs"), TimeRemainingColumn(),
            console=console, transient=True, redirect_stdout=False, redirect_stderr=False,
        )  # fmt: skip
        self._task = self._bar.add_task("runs", total=runs, completed=there)
        self._bar.start()
        console.show_cursor()  # otherwise the cursor would stay hidden after SIGKILL

    def advance(self, runs: int) -> None:
        """Add this number of finished runs."""
        self._bar.advance(self._task, runs)

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()


class Nothing:
    """The display for `--quiet`."""

    def advance(self, runs: int) -> None:
        """Print nothing."""

    def close(self) -> None:
        """Do nothing."""


def progress(there: int, runs: int, quiet: bool = False) -> Lines | Bar | Nothing:
    """Return the display for standard output."""
    if quiet:
        return Nothing()
    return Bar(there, runs, Console()) if sys.stdout.isatty() else Lines(there, runs)


def collect(answers: Generator[Answer | None, None, None], folder: SweepFolder, runs: int, quiet: bool) -> str:
    """Save runs as they finish; return the signal that stopped them, or an empty text."""
    with (
        Interrupts() as interrupts,
        contextlib.closing(progress(folder.there, runs, quiet)) as shown,
        contextlib.closing(answers),
    ):
        for rows in answers:
            if isinstance(rows, Failure):
                raise rows.error()
            if rows:
                folder.append(rows)
                shown.advance(len(rows))
            if interrupts.count:
                return interrupts.name
    return ""
