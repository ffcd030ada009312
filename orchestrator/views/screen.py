"""What a person, a log or a machine sees of a run while it goes on."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Protocol

from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.topologies.schema import Topology

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

    def close(self) -> None:
        """Leave the terminal as it was, whether there was a verdict or not."""


def left_behind(folder: Path) -> str:
    """What a run leaves, and how it is looked at."""
    # The command stands beside our own interpreter, which need not be on the PATH.
    command = "orchestrator" if shutil.which("orchestrator") else Path(sys.executable).with_name("orchestrator")
    return f"run folder {folder}\nsee it again with: {command} open {folder}"


class Lines:
    """Plain lines, for logs and pipes, and for terminals with --plain."""

    def __init__(self, steps: int, interactive: bool = False) -> None:
        self.interactive = interactive
        self._steps, self._said = steps, time.monotonic()

    def say(self, text: str) -> None:
        try:
            print(text, flush=True)
        except OSError:  # a reader who has left, or a full disk, does not end the run: what is said is lost
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

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

    def say(self, text: str) -> None:
        with contextlib.suppress(OSError):
            print(text, file=sys.stderr, flush=True)

    def progress(self, batch: Batch) -> None:
        pass

    def verdict(self, verdict: Verdict, folder: Path) -> None:
        print(json.dumps({"folder": str(folder), **verdict.content}), flush=True)

    def close(self) -> None:
        pass


class Quiet:
    """Nothing at all."""

    interactive = False

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
