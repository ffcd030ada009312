"""The exit code of a command: every exception becomes one line on standard error and a code of `Exit`."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer

from hedgerow.orchestrator.cli.spelling import nearest
from hedgerow.orchestrator.ground.signals import EndNowError
from hedgerow.topologies.errors import Code, Exit, HedgerowError, TopologyError, UserError
from hedgerow.topologies.escape import echo
from hedgerow.wire import crash, start
from hedgerow.wire.limits import causes, limit_reached

if TYPE_CHECKING:
    from hedgerow.orchestrator.metrics.verdict import Verdict
    from hedgerow.orchestrator.views.screen import Screen

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Where standard output leads, no more can be written."""
OF_PATHS = {
    *(errno.EACCES, errno.EEXIST, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOENT, errno.ENOTDIR),
    *(errno.ENOTEMPTY, errno.EPERM, errno.EROFS, errno.ETXTBSY, errno.ESTALE, errno.ENXIO, errno.EINVAL),
}
"""The errors of a path that the user gave, or of a folder on it."""


def run_to_exit_code(command: Callable[[], int]) -> int:
    """Run `command` and return the exit code of this process."""
    try:
        code = command()
        if code == start.INTERRUPTED:  # typer has caught the KeyboardInterrupt
            code = start.end_of_command()
        with contextlib.suppress(BrokenPipeError):  # the reader of the pipe has closed it, and needs no more
            sys.stdout.flush()
    except TopologyError as error:
        _complain(f"{error}\n{error.summary}")
        code = 2
    except UserError as error:
        _complain(f"error: {error}")
        code = 2
    except EndNowError as error:
        _complain(f"stopped: {error}")
        code = Exit.UNKNOWN
    except HedgerowError as error:
        _complain(f"error: {error}")
        code = Exit.CRASH if error.code == Code.CRASH else Exit.UNKNOWN
    except (typer.Abort, KeyboardInterrupt):
        code = start.end_of_command()
    except BaseException as error:  # a panic of a Rust library is not an Exception
        code = _unexpected(error)
    return code


def _suggest_one(error: Any) -> None:
    """Replace the options that the command line library suggests for a misspelt one by the nearest one."""
    command = getattr(getattr(error, "ctx", None), "command", None)
    if command is not None and getattr(error, "possibilities", None) is not None and hasattr(error, "option_name"):
        options = {name for one in command.params for name in (*one.opts, *one.secondary_opts) if name[:2] == "--"}
        meant = nearest(error.option_name, {*options, "--help"})
        error.possibilities = [meant] if meant else []


def _unexpected(error: BaseException) -> int:
    """Report in one line an unexpected error that ended the command; return the exit code."""
    if isinstance(error, OSError | SystemExit) and _nobody_reads():
        return Exit.VALID  # the reader has left; click turns this into a SystemExit
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 0 if error.code is None else Exit.UNKNOWN
    # A library that closes its file may fail for a second time, and hide the first error.
    full = next((one for one in causes(error) if isinstance(one, OSError) and one.errno in FULL), None)
    if full is not None:
        _complain(f"error: the output is incomplete: {full.strerror}; free space, or choose another place")
        return Exit.USER_MISTAKE
    if isinstance(error, Exception) and hasattr(error, "show"):
        _suggest_one(error)
        with contextlib.suppress(OSError):
            shown = io.StringIO()
            error.show(file=shown)  # a wrong option or argument, with the message of the command line library
            echo(shown.getvalue(), error=True, end="")
        return Exit.USER_MISTAKE
    reached = limit_reached(error)
    if reached is None and isinstance(error, OSError) and (mistake := _mistake_of_path(error)):
        _complain(f"error: {mistake}")
        return Exit.USER_MISTAKE
    _complain(f"error: {reached or crash.report(error)}")
    return Exit.CRASH if reached is None else Exit.UNKNOWN


def _mistake_of_path(error: OSError) -> str:
    """Return the problem and the fix of a path that the user chose, or an empty text for another error."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return "the working directory was removed. Change to a folder that exists."
    if error.errno not in OF_PATHS or error.filename is None:
        return ""
    return f"{error.filename!s}: {error.strerror}. Name another path, or correct its permissions."


def _nobody_reads() -> bool:
    """Return True if standard output is a pipe without a reader, or a terminal that was closed."""
    poll = select.poll()
    with contextlib.suppress(OSError, ValueError):
        poll.register(sys.stdout.fileno(), 0)
        return any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0))
    return False


def code_of_run(verdict: Verdict, display: Screen) -> int:
    """Return the exit code of a run; it is unknown if the verdict of a valid run could not be shown."""
    if (lost := display.outlet.incomplete) is not None and verdict.exit_code == Exit.VALID:
        _complain(f"error: standard output: the verdict was not shown: {lost.strerror}. Read it in verdict.json.")
        return Exit.UNKNOWN
    return verdict.exit_code


def _complain(text: str) -> None:
    with contextlib.suppress(OSError):
        echo(text, error=True)
