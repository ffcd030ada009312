"""Files that may come from others: only regular files are opened, because others could block the reader."""

from __future__ import annotations

import os
import stat
from io import BufferedReader
from pathlib import Path

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import escape
from hedgerow.topologies.paths import real_path


def check_regular(path: Path, inside: Path | None = None) -> os.stat_result:
    """Return the status of a regular file; raise UserError for other files, and OSError if the path does not exist.

    inside: the folder that a symbolic link must not lead out of.
    """
    status = path.stat()
    if inside is not None and not real_path(path).is_relative_to(real_path(inside)):
        raise UserError(f"{path}: is a link out of its folder. Put the file itself there.", code=Code.FILE_NOT_REGULAR)
    _refuse_others(path, status)
    return status


def open_regular(path: Path, inside: Path | None = None) -> BufferedReader:
    """Open a regular file to read, in bytes; errors as in `check_regular`."""
    check_regular(path, inside)
    # The file can change between the check and the opening. Without O_NONBLOCK, opening a FIFO would wait for a writer.
    file = open(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "rb")  # noqa: SIM115
    try:
        _refuse_others(path, os.fstat(file.fileno()))
    except UserError:
        file.close()
        raise
    return file


def read_regular(path: Path, inside: Path | None = None, growth: int = 1, start: int = 0) -> bytes:
    """Return the content of a regular file from byte `start`; raise UserError if it takes more memory than allowed.

    growth: the memory per byte of the file, after parsing.
    """
    with open_regular(path, inside) as file:
        size = max(os.fstat(file.fileno()).st_size - start, 0)
        budget.require(path, size * growth)
        file.seek(start)
        return file.read(size)


def _refuse_others(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(status.st_mode)), "special file")
        # Do not advise the removal of /dev/null, or of a folder with content.
        cure = "Remove it, or name another." if kind in ("FIFO", "socket") else "Name a regular file."
        raise UserError(f"{path}: is a {kind}, not a regular file. {cure}", code=Code.FILE_NOT_REGULAR)


_KINDS = (
    (stat.S_ISDIR, "folder"),
    (stat.S_ISFIFO, "FIFO"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


def last_text(path: Path, most: int = 2**16) -> str:
    """Return the last `most` bytes of a regular file as escaped text; OSError passes."""
    with open_regular(path) as file:
        file.seek(max(os.fstat(file.fileno()).st_size - most, 0))
        return escape(file.read(most).decode(errors="replace"))
