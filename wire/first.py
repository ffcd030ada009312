"""The very first thing that a command does: a Ctrl-C while Python still loads modules ends it without a traceback.

Nothing is imported here that Python has not loaded already: until `quiet` was called, a Ctrl-C shows a traceback.
"""

import _signal  # type: ignore[import-not-found]
import os
import sys

LINE = "stopped: {}\n"
"""The line of a command that a signal ended."""


def show(name: str) -> None:
    """Write the line about a signal to standard error, unless that is a full pipe, where a write would wait forever.

    A signal handler may call this: `print` fails if the signal arrived while it ran.
    """
    try:
        import select  # noqa: PLC0415 (only now: see above)

        number = sys.stderr.fileno()
        if select.select([], [number], [], 0)[1]:
            os.write(number, LINE.format(name).encode())
    except (AttributeError, ImportError, OSError, ValueError):
        return  # standard error is closed


def end(*_: object) -> None:
    """End this process with one line and the exit code of a Ctrl-C."""
    show("Ctrl-C")
    os._exit(128 + _signal.SIGINT)


def quiet() -> None:
    """End without a traceback on Ctrl-C, until `wire.start` takes over; an ignored SIGINT stays ignored."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, end)
