"""A law that calls os._exit: it would end the whole process without a word, and the exit code would be the law's."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import FrameType
from typing import NoReturn

_OURS = str(Path(__file__).parents[1]) + os.sep
"""the folder of this package"""
_EXIT = os._exit


def guard() -> None:
    """Make os._exit raise SystemExit where a law calls it in this process: then it is an error of the law.

    All other calls are as before: those of this project, of Python, of a process that the law forks, and of the
    program of the user outside of a law.
    """
    own = os.getpid()

    def exit_or_raise(status: int) -> NoReturn:
        frame = sys._getframe(1)
        if os.getpid() == own and not _is_ours(frame) and not _is_of_python(frame) and _is_in_call_of_ours(frame):
            raise SystemExit(f"os._exit({status})")
        _EXIT(status)

    os._exit = exit_or_raise


def _is_ours(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith(_OURS)


def _is_of_python(frame: FrameType) -> bool:
    """Return True for a module of the standard library, such as multiprocessing."""
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] in sys.stdlib_module_names - {"__main__"}


def _is_in_call_of_ours(frame: FrameType | None) -> bool:
    while frame is not None:
        if _is_ours(frame):
            return True
        frame = frame.f_back
    return False
