"""The lines of a law in its file: where a method is defined, and where an exception was raised."""

from __future__ import annotations

import contextlib
import inspect
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import Any

_OURS = str(Path(__file__).resolve().parent)


def files_of(law: type[Any]) -> list[str]:
    """Return the files of a class and of the classes that it is derived from, as tracebacks name them."""
    files = []
    for one in law.__mro__:
        with contextlib.suppress(TypeError, OSError, AttributeError):
            files.append(inspect.getfile(one))
    return files


def line_of(law: type[Any], method: str) -> str:
    """Return `file:line: ` of a method of a law, as the start of a message; empty if it has no source.

    If the class inherits the method from another file, it is the line of the class.
    """
    called = inspect.unwrap(getattr(law, method, law))
    code = getattr(called, "__code__", None)
    if code is not None and code.co_filename in files_of(law)[:1]:
        return f"{_short(code.co_filename)}:{code.co_firstlineno}: "
    try:
        return f"{_short(inspect.getfile(law))}:{inspect.getsourcelines(law)[1]}: "
    except (OSError, TypeError):
        return ""


def place_of(error: BaseException, law: type[Any]) -> str:
    """Return `file:line: ` of the line in the law that raised an exception, as the start of a message.

    It is the last line in a file of the law, and of those the last one outside of this project. If there is none, it is
    the last line of all.
    """
    frames = traceback.extract_tb(error.__traceback__)
    files = set(files_of(law))
    own = [frame for frame in frames if frame.filename in files]
    foreign = [frame for frame in frames if not str(Path(frame.filename).resolve()).startswith(_OURS)]
    found = [frame for frame in own if frame in foreign] or own or foreign
    return f"{_short(found[-1].filename)}:{found[-1].lineno}: " if found else ""


def place_in_module(error: BaseException) -> str:
    """Return `file:line: ` of the line of a module that failed as it was imported; empty if no line of it ran."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{_short(error.filename)}:{error.lineno}: "
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith("<") and not str(Path(frame.filename).resolve()).startswith(_OURS)
    ]
    frames = [frame for frame in frames if Path(frame.filename).parent.name != "importlib"]
    return f"{_short(frames[-1].filename)}:{frames[-1].lineno}: " if frames else ""


def running(thread: int, law: type[Any]) -> str:
    """Return `file:line` of the line of the law that a thread executes now; empty if it executes none."""
    frame: FrameType | None = sys._current_frames().get(thread)
    own = set(files_of(law))
    while frame is not None:
        if frame.f_code.co_filename in own:
            return f"{_short(frame.f_code.co_filename)}:{frame.f_lineno}"
        frame = frame.f_back
    return ""


def call_of(thread: int, law: type[Any]) -> FrameType | None:
    """Return the frame of the call of a law that a thread makes now, the first of its frames in a file of the law."""
    frame: FrameType | None = sys._current_frames().get(thread)
    own, call = set(files_of(law)), None
    while frame is not None:
        call = frame if frame.f_code.co_filename in own else call
        frame = frame.f_back
    return call


def _short(file: str) -> str:
    """Return a path from the working directory where the file is below it."""
    with contextlib.suppress(ValueError, OSError):
        return str(Path(file).resolve().relative_to(Path.cwd().resolve()))
    return file
