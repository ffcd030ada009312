"""The spelling of a path for libraries that take UTF-8 alone; a path of Unix may hold any bytes."""

from __future__ import annotations

import os
from pathlib import Path

_OPENED: dict[str, int] = {}
"""A descriptor of each folder whose own spelling is no UTF-8, for as long as this process lives."""


def is_utf8(text: str) -> bool:
    """Return True if `text` holds no byte that Python could not decode."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def shown(text: str) -> str:
    """Return `text` with an escape for each byte that is no UTF-8, for titles, names and pages."""
    return text.encode(errors="backslashreplace").decode()


def spelled(path: Path) -> str:
    """Return a path to the same file that is UTF-8: its own, or one by way of a descriptor of its folder.

    pyarrow and Rerun encode a path as UTF-8, and would raise UnicodeEncodeError for another.
    Raises OSError if the folder of such a path cannot be opened.
    """
    if is_utf8(str(path)):
        return str(path)
    path = path.absolute()
    # The nearest folder from which the rest is UTF-8; a file of such a name is reached by its own descriptor.
    at = next((one for one in path.parents if is_utf8(str(path.relative_to(one)))), path)
    return str(Path(f"/proc/self/fd/{_descriptor(str(at))}") / path.relative_to(at))


def _descriptor(folder: str) -> int:
    there = os.stat(folder)
    number = _OPENED.get(folder)
    # The folder may be another than before, by the same name.
    if number is None or not os.path.samestat(os.fstat(number), there):
        number = _OPENED[folder] = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    return number
