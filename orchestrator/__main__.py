"""The command `orchestrator`."""

from __future__ import annotations

from hedgerow.wire import first

first.quiet()

import contextlib  # noqa: E402 (a Ctrl-C while they load must find the handler of `first`)
import os  # noqa: E402
import sys  # noqa: E402
import threading  # noqa: E402
import time  # noqa: E402
from typing import NoReturn  # noqa: E402

import hedgerow  # noqa: E402
from hedgerow.topologies.escape import echo  # noqa: E402
from hedgerow.wire import start  # noqa: E402

BEGAN = time.monotonic()
MIN_OPEN_FILES, MIN_MEMORY, MIN_MEMORY_UP = 32, 1200 * 10**6, 2000 * 10**6
"""With less, libraries end a process without a message, or wait for ever. Most of the memory is only reserved."""


def main() -> NoReturn:
    """Run the command line as the whole of this process, and exit with its code."""
    try:
        # Before all other imports: until then, a Ctrl-C ends with a traceback.
        start.begin()
        start.end_by_signals()
        _settle_environment()
        from hedgerow.wire.stderr_relay import StderrRelay  # noqa: PLC0415

        # The command that started a network in the background escapes its output, and waits for the end of it.
        with contextlib.nullcontext() if "HEDGEROW_DETACHED" in os.environ else StderrRelay():
            sys.unraisablehook, threading.excepthook = _ignored, _failed_thread
            code = _code()
    except KeyboardInterrupt:
        code = start.end_of_command()
    with contextlib.suppress(OSError, ValueError, KeyboardInterrupt):
        sys.stdout.flush()
        sys.stderr.flush()
    # Not sys.exit: a stalled viewer's threads must not hold the process (orchestrator.views.rerun.stream).
    os._exit(code)


def _code() -> int:
    """Run the command line; for `up`, start the fork server first, so that both load at the same time."""
    from hedgerow.topologies.errors import Exit, HedgerowError  # noqa: PLC0415
    from hedgerow.wire import limits  # noqa: PLC0415

    launches = "up" in sys.argv[1:2] and not {"--help", "--detach"} & set(sys.argv)
    try:
        limits.need("a command", open_files=MIN_OPEN_FILES, memory=MIN_MEMORY)
        limits.need("`up`", memory=MIN_MEMORY_UP if launches else 0)
        from hedgerow.orchestrator.launch.fork_client import ForkClient  # noqa: PLC0415

        fork_client = ForkClient() if launches else None
        with start.loading():
            from hedgerow.orchestrator.cli.main import run_command  # noqa: PLC0415

        start.command_begins()
        return run_command(BEGAN, fork_client)
    except KeyboardInterrupt:  # before there was a run to end
        return start.end_of_command()
    except HedgerowError as error:
        with contextlib.suppress(OSError):
            echo(f"error: {error}", error=True)
        return Exit.UNKNOWN
    except BaseException as error:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in hedgerow.NEEDED:
            echo(f"error: {hedgerow.missing('this command', error.name)}", error=True)
            return Exit.USER_MISTAKE
        return _failed(error)


MOST_FILES = 10
"""Tracebacks of threads that are kept: a law may start a thread at every step."""
_FAILED: list[BaseException] = []


def _ignored(found: sys.UnraisableHookArgs) -> None:
    """Report in one line an exception that Python ignores, such as one while a library releases an object."""
    if isinstance(found.exc_value, KeyboardInterrupt):
        start.raise_again(found.exc_value)
        return
    with contextlib.suppress(Exception):
        echo(f"ignored: {found.exc_type.__name__}: {found.exc_value}", error=True)


def _failed_thread(found: threading.ExceptHookArgs) -> None:
    """Report in one line the exception that ended a thread, and the file of its traceback."""
    from hedgerow.wire import crash  # noqa: PLC0415

    if found.exc_value is not None and not isinstance(found.exc_value, SystemExit) and len(_FAILED) < MOST_FILES:
        _FAILED.append(found.exc_value)
        with contextlib.suppress(Exception):
            echo(
                f"error: a thread ended: {crash.summary(found.exc_value)}; {crash.record(found.exc_value)}", error=True
            )


def _settle_environment() -> None:
    """Set the environment variables that our libraries read; child processes inherit them."""
    # Threads of linear algebra would compete with the network for its cores, and the order of a sum would vary.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A notebook sets a backend that exists only in its interpreter; we draw to files.
    os.environ["MPLBACKEND"] = "Agg"
    # Pydantic would look for plugins in every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    for name in ("COLUMNS", "LINES"):
        if not _is_size(os.environ.get(name, "1")):
            del os.environ[name]  # a terminal of size zero: let libraries ask the terminal


def _is_size(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 6 and int(text) > 0


def _failed(error: BaseException) -> int:
    """Print one line about an error before the command line existed; return the exit code."""
    from hedgerow.topologies.errors import Exit  # noqa: PLC0415
    from hedgerow.wire import crash, limits  # noqa: PLC0415

    reached = limits.limit_reached(error)
    with contextlib.suppress(OSError):
        echo(f"error: {reached or crash.report(error)}", error=True)
    return Exit.CRASH if reached is None else Exit.UNKNOWN


if __name__ == "__main__":
    main()
