"""How a process of a run begins and ends: tied to its parent, with a log, and an error in one line."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import NoReturn

from hedgerow.topologies.errors import HedgerowError, UserError
from hedgerow.wire.runtime import let_numbers_overflow

USER_ERROR = 2
"""The exit code of a process that failed by its user's mistake: to start it again would not help."""
ERROR_PREFIX = "error: "
"""The last line of the log of a process that failed starts so."""
LINE, TIME = "%(asctime)s.%(msecs)03d %(name)s: %(message)s", "%H:%M:%S"
"""What a line of a log looks like."""
_ENDS = (signal.SIGTERM, signal.SIGINT)
_stop: Callable[[], None] | None = None
"""what the first of them does, if it is not to end us"""


def run_child(body: Callable[[], None]) -> NoReturn:
    """Run `body` as the whole of this process, as `run_alone` does, for as long as its parent lives.

    Standard input is the lifeline: the parent holds its other end open for as long as the process is to live, and
    even SIGKILL of the parent ends it.
    """

    def whole() -> None:
        threading.Thread(target=_watch_parent, name="lifeline", daemon=True).start()
        body()

    run_alone(whole)


def run_alone(body: Callable[[], None]) -> NoReturn:
    """Run `body` as the whole of this process; exit 0, 2 for a user's mistake, 1 for any other failure.

    Who is alone, far from `up`, lives until the plant says END, a SIGTERM or a Ctrl-C.
    """
    let_numbers_overflow()
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format=LINE, datefmt=TIME)
    # Every thread that is made from here on leaves these to the one that waits for them: a handler of Python's would
    # have to wait for the main thread, and one that is just about to wait itself would not hear of it.
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    threading.Thread(target=_watch_signals, name="signals", daemon=True).start()
    code = 0
    try:
        body()
    except HedgerowError as error:
        code = USER_ERROR if isinstance(error, UserError) else 1
        print(f"{ERROR_PREFIX}{error}", file=sys.stderr)
    except Exception as error:
        code = 1
        logging.exception("unexpected")
        print(f"{ERROR_PREFIX}{type(error).__name__}: {error}", file=sys.stderr)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody reads it
            stream.flush()
    # Not sys.exit: Zenoh's threads may outlive a session that was not closed, and must not hold the process.
    os._exit(code)


@contextlib.contextmanager
def stopped_by(stop: Callable[[], None]) -> Iterator[None]:
    """While the block lasts, the first SIGTERM or Ctrl-C calls `stop`, on a thread of its own; the next ends us."""
    global _stop  # noqa: PLW0603 (a process has one way to end)
    _stop = stop
    try:
        yield
    finally:
        _stop = None


def _watch_signals() -> None:
    number = signal.sigwait(_ENDS)
    if (stop := _stop) is not None:
        threading.Thread(target=stop, name="stop", daemon=True).start()  # not here, who must hear the next
        number = signal.sigwait(_ENDS)
    # Nothing is flushed: a log is written line by line, and whoever hangs in a full pipe would hold us too.
    os._exit(128 + number)


def _watch_parent() -> None:
    while os.read(0, 4096):
        pass
    os._exit(1)
