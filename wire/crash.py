"""A defect of this project: its traceback in a file, and one line that names the file."""

from __future__ import annotations

import contextlib
import os
import tempfile
import traceback
from collections.abc import Iterator
from pathlib import Path

from hedgerow.topologies.errors import Code, HedgerowError


def summary(error: BaseException) -> str:
    """Return one line about an unexpected exception."""
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words[:200]}" if words else type(error).__name__


def report(error: BaseException, log: Path | None = None) -> str:
    """Write the traceback to `log`, or to a new file if that fails; return one line that names the file."""
    return f"this is a defect of hedgerow: {summary(error)}; {record(error, log)}"


def record(error: BaseException, log: Path | None = None) -> str:
    """Write the traceback to `log`, or to a new file if that fails; return where it is."""
    file = _written("".join(traceback.format_exception(error)), log)
    return f"the traceback is in {file}" if file is not None else f"no file can be written; it was at {_place(error)}"


@contextlib.contextmanager
def reported() -> Iterator[None]:
    """Raise HedgerowError (Code.CRASH) with one line for an unexpected exception in the block; see `report`."""
    try:
        yield
    except HedgerowError:
        raise
    except Exception as error:
        from hedgerow.wire.limits import limit_reached  # noqa: PLC0415

        if (reached := limit_reached(error)) is not None:
            raise reached from error
        raise HedgerowError(report(error), code=Code.CRASH) from None


def _written(text: str, log: Path | None) -> Path | None:
    data = text.encode(errors="backslashreplace")
    if log is not None:
        with contextlib.suppress(OSError), log.open("ab") as opened:
            opened.write(data)
            return log
    for folder in (tempfile.gettempdir, os.getcwd, lambda: str(Path.home())):
        with contextlib.suppress(OSError, RuntimeError):
            number, name = tempfile.mkstemp(prefix="hedgerow-crash-", suffix=".txt", dir=folder())
            try:
                with open(number, "wb") as opened:
                    opened.write(data)
            except OSError:  # the disk is full
                os.unlink(name)
                raise
            return Path(name)
    return None


def _place(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    return f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown place"
