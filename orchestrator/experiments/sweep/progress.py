"""How far a sweep is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hedgerow.topologies.escape import echo

LINE_EVERY_S = 10.0


class Lines:
    """For logs and pipes."""

    def __init__(self, there: int, runs: int) -> None:
        self._there, self._done, self._runs = there, there, runs
        self._began = self._said = time.monotonic()

    def advance(self, runs: int) -> None:
        """So many more runs are there."""
        self._done += runs
        if (now := time.monotonic()) - self._said >= LINE_EVERY_S:
            self._said = now
            rate = (self._done - self._there) / (now - self._began)
            echo(f"{self._done} of {self._runs} runs, {rate:.3g} runs/s")

    def close(self) -> None:
        """Nothing is left behind."""


class Bar:
    """For a terminal."""

    def __init__(self, there: int, runs: int, console: Console) -> None:
        self._bar = Progress(
            BarColumn(), MofNCompleteColumn(), TextColumn("runs"), TimeRemainingColumn(),
            console=console, transient=True, redirect_stdout=False, redirect_stderr=False,
        )  # fmt: skip
        self._task = self._bar.add_task("runs", total=runs, completed=there)
        self._bar.start()
        console.show_cursor()  # else somebody would have to bring it back after SIGKILL

    def advance(self, runs: int) -> None:
        """So many more runs are there."""
        self._bar.advance(self._task, runs)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.stop()


class Nothing:
    """For `--quiet`."""

    def advance(self, runs: int) -> None:
        """Print nothing."""

    def close(self) -> None:
        """Leave nothing."""


def progress(there: int, runs: int, quiet: bool = False) -> Lines | Bar | Nothing:
    """Return the display for standard output."""
    if quiet:
        return Nothing()
    return Bar(there, runs, Console()) if sys.stdout.isatty() else Lines(there, runs)
