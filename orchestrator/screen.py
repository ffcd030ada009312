"""What a person, a log or a machine sees of a run while it goes on."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from pathlib import Path
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from orchestrator.observe import Batch
from orchestrator.verdict import INVALID, VALID, Verdict

LINE_EVERY_S = 2.0


class Screen(Protocol):
    """Told of a run's course; says it in its own way."""

    interactive: bool
    """whether somebody sits before it"""

    def say(self, text: str) -> None:
        """Something that happened."""

    def progress(self, batch: Batch) -> None:
        """Some more steps are done."""

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        """The run is over."""


def _rate(steps: int, seconds: float) -> str:
    return f"{steps / seconds:.0f} steps/s" if seconds > 0 else ""


def _left_behind(folder: Path) -> str:
    recording = folder / "run.rrd"
    if not recording.exists():
        return f"run folder {folder}"
    # The viewer ships with rerun-sdk, beside our own interpreter, which need not be on the PATH.
    return f"run folder {folder}\nopen its recording with: {Path(sys.executable).with_name('rerun')} {recording}"


class Lines:
    """Plain lines, for logs and pipes."""

    interactive = False

    def __init__(self, steps: int) -> None:
        self._steps, self._said = steps, time.monotonic()

    def say(self, text: str) -> None:
        with contextlib.suppress(BrokenPipeError):  # a reader who has left does not end the run
            print(text, flush=True)

    def progress(self, batch: Batch) -> None:
        now, done = time.monotonic(), int(batch.t[-1]) + 1
        if now - self._said >= LINE_EVERY_S:
            self._said = now
            self.say(
                f"step {done} of {self._steps}, regret D {batch.regret_sum[-1]:.4g}, {batch.right[-1]} estimates right"
            )

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        self.say(_left_behind(folder))
        self.say(verdict.line())


class Bar:
    """A progress bar on a terminal."""

    interactive = True

    def __init__(self, steps: int) -> None:
        self._console = Console(highlight=False, soft_wrap=True)
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(), console=self._console, transient=True,
        )  # fmt: skip
        self._task = self._bar.add_task("steps", total=steps, rate="")
        self._began: float | None = None

    def say(self, text: str) -> None:
        self._console.print(text, markup=False)

    def progress(self, batch: Batch) -> None:
        done = int(batch.t[-1]) + 1
        if self._began is None:
            self._began = time.monotonic()
            self._bar.start()
        self._bar.update(self._task, completed=done, rate=_rate(done, time.monotonic() - self._began))

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        self._bar.stop()
        self.say(_left_behind(folder))
        colour = {VALID: "green", INVALID: "bold red"}.get(verdict.verdict, "yellow")
        self._console.print(verdict.line(), style=colour, markup=False)


class Json:
    """One JSON object on standard output, when all is over; the rest goes to standard error."""

    interactive = False

    def say(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        print(json.dumps({"folder": str(folder), **verdict.content}), flush=True)


class Quiet:
    """Nothing at all."""

    interactive = False

    def say(self, text: str) -> None:
        pass

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        pass


def screen(steps: int, as_json: bool) -> Screen:
    """The screen that fits where we run."""
    if as_json:
        return Json()
    return Bar(steps) if sys.stdout.isatty() else Lines(steps)
