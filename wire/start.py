"""The start of every process: streams that accept every character, room for open files, and a quiet Ctrl-C.

Import this module before everything slow: it loads little but the standard library.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from types import FrameType
from typing import Any, NoReturn

from hedgerow.topologies.errors import Exit
from hedgerow.topologies.escape import EscapedStream, echo
from hedgerow.wire import first

INTERRUPTED = 128 + signal.SIGINT
"""The exit code after a Ctrl-C."""
MOST_OPEN_FILES = 2**16
"""The maximum number of open files that a process asks for.

Some libraries close every number below the limit, one by one.
"""


def begin() -> None:
    """Prepare this process before it loads slow modules; a second call changes nothing."""
    quiet_ctrl_c()
    open_streams()
    raise_open_files()


@contextlib.contextmanager
def whole(command: str) -> Iterator[None]:
    """Exit with one line if the block raises: 2 if `command` lacks a package, 3 at a limit, 70 for a defect of ours."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("numpy", "zenoh"):
            _fail(error)
        _end(f"{command} needs {error.name}. Install it with: pip install numpy eclipse-zenoh", Exit.USER_MISTAKE)
    except KeyboardInterrupt:
        sys.exit(end_of_command())
    except SystemExit:
        raise
    except BaseException as error:  # a panic of a Rust library is not an Exception
        _fail(error)


def _fail(error: BaseException) -> NoReturn:
    from hedgerow.wire import crash, limits  # noqa: PLC0415

    reached = limits.limit_reached(error)
    _end(reached or crash.report(error), Exit.CRASH if reached is None else Exit.UNKNOWN)


def _end(problem: object, code: int) -> NoReturn:
    with contextlib.suppress(OSError, ValueError):
        echo(f"error: {problem}", error=True)
    sys.exit(code)


@contextlib.contextmanager
def loading() -> Iterator[None]:
    """Load modules in the block without garbage collection, which would traverse them again and again.

    All objects of that moment are left out of later collections.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def open_streams() -> None:
    """Open standard input, output and error if they are closed; make them escape characters that their encoding lacks.

    A closed stream is opened on /dev/null. Otherwise the next pipe would get its number and be used as that stream.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            # The new file gets the lowest free number, which is that of the closed stream.
            stream = open(os.devnull, "w" if number else "r", encoding="utf-8")  # noqa: SIM115
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
        if number and isinstance(stream, io.TextIOWrapper):
            with contextlib.suppress(OSError, ValueError):  # the stream has no reader any more
                stream.reconfigure(errors="backslashreplace")
        if number and not isinstance(stream, EscapedStream):
            setattr(sys, name, EscapedStream(stream))


def raise_open_files() -> None:
    """Raise the soft limit of open files to the hard limit, which needs no privileges; child processes inherit it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_OPEN_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_OPEN_FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with contextlib.suppress(OSError, ValueError):  # macOS has another, lower limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def quiet_ctrl_c() -> None:
    """End without a traceback when a Ctrl-C arrives while modules load; later it raises KeyboardInterrupt as usual.

    Without this, many modules turn a KeyboardInterrupt into another error while they load. A disposition other than
    Python's own stays: a SIGINT that was ignored at the start stays ignored.
    """
    here = threading.current_thread() is threading.main_thread()
    if here and signal.getsignal(signal.SIGINT) in (signal.default_int_handler, first.end):
        signal.signal(signal.SIGINT, _interrupt)


def end_by_signals() -> None:
    """End on SIGTERM and SIGHUP as on Ctrl-C, so that a command removes its temporary files."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _interrupt)


def name_of(number: int) -> str:
    """Return the name of a signal as a user knows it."""
    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name


def end_of_command() -> int:
    """Print one line about the signal that ended a command, unless it was printed; return the exit code."""
    global _is_shown  # noqa: PLW0603 (a process has one command)
    if not _is_shown:
        _is_shown = True
        first.show(name_of(_last))
    return 128 + _last


def command_begins() -> None:
    """From now on, a signal during an import waits for its end: there may be temporary files to remove."""
    global _has_command  # noqa: PLW0603 (a process has one command)
    _has_command = True


_has_command = _is_shown = False
_last: int = signal.SIGINT
_AGAIN_S = 0.02


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _last  # noqa: PLW0603
    if _is_shown:  # the process is at its end, and may wait for a reader of its output
        os._exit(128 + number)
    _last = number
    if not _has_command and _is_import(frame):
        os._exit(end_of_command())
    _raise(KeyboardInterrupt(), frame)


def raise_again(error: BaseException) -> None:
    """Raise in the main thread, a little later, an error of a signal's handler that Python has ignored.

    The signal may arrive while a destructor or a callback of the garbage collector runs, and nothing can be raised out
    of them. The command would then run on.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGALRM, lambda _, frame: _raise(error, frame))
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def _raise(error: BaseException, frame: FrameType | None) -> None:
    """Raise the error, or do so after the import that runs."""
    if not _is_import(frame):
        raise error
    raise_again(error)


def _is_import(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def ignored(numbers: Iterable[signal.Signals]) -> set[signal.Signals]:
    """Return the signals that this process ignores, as under nohup or in background jobs; they must stay ignored."""
    return {number for number in numbers if signal.getsignal(number) is signal.SIG_IGN}


def handle(number: signal.Signals, handler: Any) -> Any:
    """Install a signal handler, unless the signal is ignored; return the previous disposition."""
    before = signal.getsignal(number)
    if before is not signal.SIG_IGN:
        signal.signal(number, handler)
    return before
