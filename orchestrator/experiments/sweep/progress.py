"""The progress of a sweep: a bar on a terminal, lines from time to time elsewhere."""

from __future__ import annotations

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hedgerow.topologies.escape import echo

LINE_EVERY_S = 10.0


class Lines:
    """The progress in logs and pipes."""

    def __init__(self, there: int, runs: int) -> None:
        self._there, self._done, self._runs = there, there, runs
        self._began = self._said = time.monotonic()

    def advance(self, runs: int) -> None:
        """Add this number of finished runs."""
        self._done += runs
        if (now := time.monotonic()) - self._said >= LINE_EVERY_S:
            self._said = now
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
