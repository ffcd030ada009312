"""How a process of a run begins and ends: tied to its parent, with a log, and an error in one line."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import NoReturn

from topologies.errors import HedgerowError, UserError

USER_ERROR = 2
"""The exit code of a process that failed by its user's mistake: to start it again would not help."""
ERROR_PREFIX = "error: "
"""The last line of the log of a process that failed starts so."""


def run_child(body: Callable[[], None], on_orphaned: Callable[[], None] = lambda: None) -> NoReturn:
    """Run `body` as the whole of this process, as `run_alone` does, for as long as its parent lives.

    Standard input is the lifeline: the parent holds its other end open for as long as the process is to live, and
    even SIGKILL of the parent ends it. `on_orphaned` is called first when that happens.
    """
    threading.Thread(target=_watch_parent, args=(on_orphaned,), name="lifeline", daemon=True).start()
    run_alone(body)


def run_alone(body: Callable[[], None]) -> NoReturn:
    """Run `body` as the whole of this process; exit 0, 2 for a user's mistake, 1 for any other failure.

    Who is alone, far from `up`, lives until the plant says END, a SIGTERM or a Ctrl-C.
    """
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.INFO,
        format="%(asctime)s.%(msecs)03d %(name)s: %(message)s",
        datefmt="%H:%M:%S",
    )
    # Both end us at once, and not somewhere in a step. The first process of a container has no default for them.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda caught, _: _leave(128 + caught))
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
    _leave(code)


def _watch_parent(on_orphaned: Callable[[], None]) -> None:
    while os.read(0, 4096):
        pass
    try:
        on_orphaned()
    finally:
        _leave(1)


def _leave(code: int) -> NoReturn:
    # Not sys.exit: Zenoh's threads may outlive a session that was not closed, and must not hold the process.
    sys.stderr.flush()
    os._exit(code)
