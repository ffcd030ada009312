"""The frame of a process of a run: its tie to the parent, its log, its exit code, and an error in one line."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from typing import NoReturn

from hedgerow.topologies.errors import Exit, HedgerowError, UserError
from hedgerow.topologies.escape import echo, escape
from hedgerow.wire import crash, first, start
from hedgerow.wire.limits import limit_reached
from hedgerow.wire.runtime import let_numbers_overflow
from hedgerow.wire.stderr_relay import StderrRelay

USER_ERROR = Exit.USER_MISTAKE
"""The exit code after a mistake of the user. A restart would not help."""
ERROR_PREFIX = "error: "
"""The last line of the log of a failed process starts with this."""
SLOW_LAW = "has been running for"
"""The log of an agent has this in its lines about a slow law; the operator searches for them."""
LINE, TIME = "%(asctime)s.%(msecs)03d %(name)s: %(message)s", "%H:%M:%S"
"""The format of a line of a log."""


class Line(logging.Formatter):
    """The formatter of our logs: a message is one line, and neither it nor a traceback acts on a terminal."""

    def __init__(self, form: str = LINE) -> None:
        super().__init__(form, TIME)

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 (logging's name)
        """Return the line without its traceback; a line feed in it would forge the next line of the log."""
        return escape(super().formatMessage(record), keep="\t")

    def format(self, record: logging.LogRecord) -> str:
        """Return the line and the traceback, if there is one."""
        return escape(super().format(record))


_ENDS = (signal.SIGTERM, signal.SIGINT)
_stop: Callable[[], None] | None = None
"""the action of the first signal, if it must not end this process"""


def escape_warnings() -> None:
    """Escape the warnings of a process without a log, which logging writes to standard error as they are."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(Line("%(message)s"))


@functools.cache
def open_log() -> None:
    """Write the log of this process to standard error; a second call changes nothing.

    The fork server opens the log of all its children, which then need not copy the memory that this writes to.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(Line())
    logging.basicConfig(handlers=[handler], level=logging.INFO)


def run_child(body: Callable[[], None]) -> NoReturn:
    """Run `body` as the whole of this process, as `run_alone` does, until its parent ends.

    Standard error is the log of this process in the run's folder, so a traceback goes there.

    Standard input is the lifeline. The parent holds the other end open for as long as the process should run. So even
    SIGKILL of the parent ends this process.
    """

    def whole() -> None:
        threading.Thread(target=_watch_parent, name="lifeline", daemon=True).start()
        body()

    run_alone(whole, logged=True)


def run_alone(body: Callable[[], None], logged: bool = False) -> NoReturn:
    """Run `body` as the whole of this process and exit with a code of `Exit`; 70 means a defect of this project.

    If `logged`, standard error is a log and receives a traceback; otherwise the traceback goes to a file that the last
    line names.

    A process without a parent runs until the plant sends END, or until a SIGTERM or a Ctrl-C.
    """
    start.begin()
    let_numbers_overflow()
    # Block these signals in every thread that starts from here on; one thread waits for them. A Python handler would
    # need the main thread, which may be about to wait and would then miss the signal. Leave an ignored signal out: the
    # kernel would still deliver it while it is blocked.
    ends = set(_ENDS) - start.ignored(_ENDS)
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)
    # A log keeps what libraries write as it is: a process for each agent would cost too much.
    with contextlib.nullcontext() if logged else StderrRelay():
        code = _run(body, logged, ends)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # standard error has no reader
            stream.flush()
    # Not sys.exit: Zenoh's threads may outlive a session that was not closed, and must not hold the process.
    os._exit(code)


def _run(body: Callable[[], None], logged: bool, ends: Collection[signal.Signals]) -> int:
    """Run `body` with a log, and return the exit code."""
    open_log()
    code = Exit.VALID
    try:
        if ends:
            threading.Thread(target=_watch_signals, args=(ends, logged), name="signals", daemon=True).start()
        body()
    except HedgerowError as error:
        code = Exit.USER_MISTAKE if isinstance(error, UserError) else Exit.UNKNOWN
        if logged and error.__cause__ is not None:  # a law raised it: its author needs all lines of the traceback
            with contextlib.suppress(Exception):
                logging.error("the traceback of the error below", exc_info=error.__cause__)
        _say(str(error))
    except BaseException as error:  # a panic of a Rust library is not an Exception
        if (reached := limit_reached(error)) is not None:
            code = Exit.UNKNOWN
            _say(str(reached))
        else:
            code = Exit.CRASH
            if logged:
                with contextlib.suppress(Exception):
                    logging.error("unexpected", exc_info=error)
            _say(f"this is a defect of hedgerow: {crash.summary(error)}" if logged else crash.report(error))
    return code


def _say(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # standard error has no reader
        echo(f"{ERROR_PREFIX}{text}", error=True)


@contextlib.contextmanager
def stopped_by(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on a separate thread at the first SIGTERM or Ctrl-C while the block lasts; exit at the next one."""
    global _stop  # noqa: PLW0603 (a process has one way to end)
    _stop = stop
    try:
        yield
    finally:
        _stop = None


def _watch_signals(ends: Collection[signal.Signals], logged: bool) -> None:
    number = signal.sigwait(ends)
    if (stop := _stop) is not None:
        # A separate thread: this one must receive the next signal.
        threading.Thread(target=stop, name="stop", daemon=True).start()
        number = signal.sigwait(ends)
    if not logged:
        first.show(start.name_of(number))
    # Flush nothing: a log is written line by line, and a full pipe would block this process.
    os._exit(128 + number)


def _watch_parent() -> None:
    while os.read(0, 4096):
        pass
    os._exit(Exit.UNKNOWN)
