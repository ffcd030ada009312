"""The spelling of a path for libraries that accept UTF-8 alone; a path of Unix may contain any bytes."""

from __future__ import annotations

import os
from pathlib import Path

_OPENED: dict[str, int] = {}
"""A descriptor of each folder with a name that is not UTF-8, until this process ends."""


def is_utf8(text: str) -> bool:
    """Return True if `text` has no byte that Python could not decode."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def shown(text: str) -> str:
    """Return `text` with an escape for each byte that is not UTF-8, for titles, names and pages."""
    return text.encode(errors="backslashreplace").decode()


def spelled(path: Path) -> str:
    """Return a UTF-8 path to the same file: its own, or one through a descriptor of its folder.

    pyarrow and Rerun encode a path as UTF-8, and raise UnicodeEncodeError for another. Raises OSError if the folder of
    such a path cannot be opened.
    """
    if is_utf8(str(path)):
        return str(path)
    path = path.absolute()
    # The nearest folder from which the rest is UTF-8; a file with such a name is opened by its own descriptor.
    at = next((one for one in path.parents if is_utf8(str(path.relative_to(one)))), path)
    return str(Path(f"/proc/self/fd/{_descriptor(str(at))}") / path.relative_to(at))


def _descriptor(folder: str) -> int:
    there = os.stat(folder)
    number = _OPENED.get(folder)
    # The name may belong to a new folder.
    if number is None or not os.path.samestat(os.fstat(number), there):
        number = _OPENED[folder] = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    return number
