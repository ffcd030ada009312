"""A progress bar on the screen for work of a known duration, and lines without a terminal."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from hedgerow.topologies.escape import echo, escape


class Progress:
    """The elapsed share of a time budget, and the latest message."""

    def __init__(self, title: str, seconds: float, quiet: bool = False) -> None:
        """Show the title; with `quiet`, show nothing."""
        self._quiet, self._began = quiet, time.monotonic()
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
        self._bar = (
            Bar(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
            if console.is_terminal and not quiet
            else None
        )
        self._title = escape(title)
        self._task = self._bar.add_task(self._title, total=seconds) if self._bar is not None else None

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self) -> None:
        """Show the elapsed time."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=time.monotonic() - self._began)

    def say(self, text: str) -> None:
        """Show a text beside the bar, or as a line on standard error."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, description=f"{self._title}: {escape(text)}")
        elif not self._quiet:
            echo(f"{time.monotonic() - self._began:6.1f} s  {text}", error=True)
