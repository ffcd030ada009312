"""The memory limit of files and rules: the need is estimated before loading, and refused above a cap."""

from __future__ import annotations

import os

from hedgerow.topologies.errors import Code, UserError

VARIABLE = "HEDGEROW_MEMORY_MB"
"""the environment variable that sets the cap"""
DEFAULT_MB = 1000
_MB = 10**6


def cap() -> int:
    """Return the cap in bytes; raise UserError if the environment variable is not a number of megabytes."""
    written = os.environ.get(VARIABLE, "").strip()
    if not written:
        return DEFAULT_MB * _MB
    if not (written.isascii() and written.isdecimal() and 0 < len(written) <= 9 and int(written)):
        raise UserError(
            f"{VARIABLE}={written[:40]!a}: is no number of megabytes. Write a whole number from 1, such as 4000.",
            code=Code.OPTION,
        )
    return int(written) * _MB


def excess(estimate: int) -> str:
    """Return why `estimate` bytes are too many, and the fix, in one sentence each; empty if they are allowed."""
    if estimate <= (allowed := cap()):
        return ""
    return f"it takes about {_shown(estimate)} of memory, and {_shown(allowed)} are allowed. {cure(estimate)}"


def cure(estimate: int) -> str:
    """Return how to allow `estimate` bytes."""
    return f"Make it smaller, or allow more with {VARIABLE}={min(-(-estimate // _MB), 10**9 - 1)}."


def require(place: object, estimate: int) -> None:
    """Raise UserError with the estimate if the data at `place` takes more memory than allowed."""
    if why := excess(estimate):
        raise UserError(f"{place}: {why}", code=Code.FILE_TOO_LARGE)


def _shown(size: int) -> str:
    return f"{size / 10**9:.1f} GB" if size >= 10**9 else f"{-(-size // _MB)} MB"
