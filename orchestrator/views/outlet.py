"""Standard output of a run, and the last lines about its folder."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Callable
from errno import EIO
from pathlib import Path

from hedgerow.orchestrator.views.rerun.viewer import has_display
from hedgerow.topologies.escape import answers, command


class Outlet:
    """Standard output that may fail: `lost` holds the first error, and the run continues."""

    def __init__(self) -> None:
        self._terminal = _leads_to_terminal()
        self.lost: OSError | None = None
        """The first error of a write."""

    def write(self, put: Callable[[], object]) -> None:
        """Call `put`, which writes to standard output; after an error all output leads nowhere."""
        try:
            put()
        except OSError as error:
            self.lost = self.lost or error
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), answers().fileno())

    @property
    def incomplete(self) -> OSError | None:
        """Return the error, or None if the reader of a pipe has left or the terminal was closed, which is not a
        failure.
        """
        closed = isinstance(self.lost, BrokenPipeError) or (self._terminal and getattr(self.lost, "errno", 0) == EIO)
        return None if closed else self.lost


def _leads_to_terminal() -> bool:
    with contextlib.suppress(OSError, ValueError):
        return answers().isatty()
    return False


def left_behind(folder: Path) -> str:
    """Return lines with the run folder and the command that shows it, as a page if there is no display.

    A run without a recording is shown from its tables: a reader of `--no-record` would expect nothing to see.
    """
    # The folder of the interpreter contains the command and may be missing in PATH.
    program = "orchestrator" if shutil.which("orchestrator") else Path(sys.executable).with_name("orchestrator")
    page = [] if has_display() else ["--viewer", "web"]
    opened = command([program, "open", folder, *page])
    if is_recorded(folder):
        return f"run folder {folder}\nsee it again with: {opened}"
    return f"run folder {folder}, without run.rrd\ndraw its tables with: {opened}"


def is_recorded(folder: Path) -> bool:
    """Return True if a folder has a recording, or a part of one."""
    return any(folder.glob("run*.rrd"))
