"""Rows of telemetry in memory that the plant and the observer of one machine share.

Over Zenoh and a socket, a row is copied six times. Here the plant writes it once, and a message of 32 bytes names its
place. The observer copies it from there before it acknowledges the message; the plant overwrites it only after that.
So nothing is lost, and the messages are the same to the byte.

The memory is a file without a name: it vanishes with the processes that hold it, however they end.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import re
from collections.abc import Sequence

import numpy as np

from hedgerow.wire.codec import decode_place, encode_place
from hedgerow.wire.message import Buffer, MessageError

_PATH = re.compile(r"/proc/[1-9][0-9]*/fd/[0-9]+")
SPARE = 2
"""Rows that are written while the observer still holds as many as the plant may send ahead."""


class SharedRows:
    """A ring of rows of `row_bytes` bytes each, at most."""

    def __init__(self, memory: mmap.mmap, row_bytes: int) -> None:
        self._memory = memory
        self._bytes = np.frombuffer(memory, np.uint8)
        self._row_bytes = row_bytes
        self._next = 0
        self.rows = len(memory) // row_bytes

    def write(self, t: int, parts: Sequence[Buffer]) -> bytes:
        """Write a row in its parts, in place of the oldest one; return the message that names its place."""
        start = at = self._next * self._row_bytes
        for part in parts:
            flat = np.frombuffer(part, np.uint8)
            self._bytes[at : at + len(flat)] = flat
            at += len(flat)
        self._next = (self._next + 1) % self.rows
        return encode_place(t, start, at - start)

    def read(self, message: bytes) -> bytes:
        """Return a copy of the row that a message names; raise MessageError if there is none."""
        start, length = decode_place(message)
        if start % self._row_bytes or length > self._row_bytes or start + length > len(self._bytes):
            raise MessageError(f"a row of {length} bytes at {start}, in a memory of {len(self._bytes)}")
        return self._bytes[start : start + length].tobytes()


def create(row_bytes: int, ahead: int) -> tuple[SharedRows | None, str]:
    """Return new memory for `ahead` rows that are not acknowledged, and its path for the plant.

    Return None and an empty path where the system has none: then rows travel in messages.
    """
    memory, path = new_memory("hedgerow-telemetry", (ahead + SPARE) * row_bytes)
    return (None if memory is None else SharedRows(memory, row_bytes)), path


def new_memory(name: str, size: int) -> tuple[mmap.mmap | None, str]:
    """Return new memory of `size` bytes, all 0, and its path; None and an empty path where the system has none."""
    try:
        descriptor = os.memfd_create(name)
    except (AttributeError, OSError):  # not Linux, or forbidden
        return None, ""
    try:
        # Reserve it now: a page that is missing later would end the plant with a signal.
        os.posix_fallocate(descriptor, 0, size)
        memory = mmap.mmap(descriptor, size)
    except OSError:
        os.close(descriptor)
        return None, ""
    return memory, f"/proc/{os.getpid()}/fd/{descriptor}"


def open_shared(path: str, row_bytes: int) -> SharedRows | None:
    """Return the memory of another process; None if it cannot be opened here, as in another container."""
    memory = open_memory(path, (1 + SPARE) * row_bytes)
    return None if memory is None else SharedRows(memory, row_bytes)


def open_memory(path: str, least: int) -> mmap.mmap | None:
    """Return the memory of another process, of at least `least` bytes; None if it cannot be opened here."""
    if not _PATH.fullmatch(path):
        return None
    with contextlib.suppress(OSError, ValueError):
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            size = os.fstat(descriptor).st_size
            if size >= least:
                return mmap.mmap(descriptor, size)
        finally:
            os.close(descriptor)
    return None


def close(path: str) -> None:
    """Close the descriptor of memory that `new_memory` made; its mappings stay."""
    if path:
        with contextlib.suppress(OSError):
            os.close(int(path.rpartition("/")[2]))
