"""States and inputs of one shard in memory that the plant and the agent of one machine share.

A long state or input message stays in this memory, and a PLACE message of 32 bytes travels instead (docs/wire.md). The
memory has two rows for states and two for inputs, and step t uses row t mod 2. The plant writes state(t + 2) only after
it used input(t) and received input(t + 1). So each end has read a row before the other end overwrites it. If the plant
continues without a late agent, that agent finds another step in the row, and refuses the message.

Each end writes its mark into the memory when it opens it. If the other end has no mark, messages travel whole. So an
end that cannot open the memory, as in another container, misses nothing.
"""

from __future__ import annotations

import mmap

import numpy as np
from numpy.typing import NDArray

from hedgerow.wire.codec import HEADER_BYTES, decode_place, encode_place, step_of
from hedgerow.wire.message import REPORT_ROWS, MessageError
from hedgerow.wire.runtime import LONG_BYTES
from hedgerow.wire.shared_rows import new_memory, open_memory

_ALIGNED = 64
_MARKS_BYTES = _ALIGNED
_NO_HEADER = b"\xff" * HEADER_BYTES
PLANT = 1
"""the mark of the plant; an agent writes the number of its life + 1"""


def _sizes(k: int, m: int) -> tuple[int, int]:
    """Return the bytes of a state and of an input of k nodes with m incidences, without spans."""
    return HEADER_BYTES + 8 * k + m, HEADER_BYTES + 8 * (1 + REPORT_ROWS) * k + m


def _aligned(size: int) -> int:
    return -(-size // _ALIGNED) * _ALIGNED


def worth_sharing(k: int, m: int) -> bool:
    """Return True if the inputs of k nodes with m incidences are long messages."""
    return _sizes(k, m)[1] > LONG_BYTES


def create_steps(k: int, m: int) -> str:
    """Return the path of new memory for a shard; empty where the system has none. `shared_rows.close` closes it."""
    return new_memory("hedgerow-steps", _whole(k, m))[1]


def _whole(k: int, m: int) -> int:
    return _MARKS_BYTES + sum(2 * _aligned(size) for size in _sizes(k, m))


class _Rows:
    """The two rows of one direction."""

    def __init__(self, memory: memoryview, start: int, size: int) -> None:
        self._memory, self._start, self._size, self._apart = memory, start, size, _aligned(size)
        self._written = -1
        """the last step written"""

    def write(self, t: int, message: bytes) -> bytes:
        """Return the PLACE message for the message of step t, which is written once; itself if it does not fit."""
        if len(message) > self._size:
            return message
        start = self._start + t % 2 * self._apart
        if t != self._written:  # leave a repeated message as it is: the other end may be reading it
            # Until the last part is written, the header has step -1: a late reader refuses a half-written row.
            self._memory[start : start + HEADER_BYTES] = _NO_HEADER
            self._memory[start + HEADER_BYTES : start + len(message)] = message[HEADER_BYTES:]
            self._memory[start : start + HEADER_BYTES] = message[:HEADER_BYTES]
            self._written = t
        return encode_place(t, start, len(message))

    def view(self, place: bytes) -> memoryview:
        """Return the message that a PLACE message names; raise MessageError if there is none."""
        start, length = decode_place(place)
        if start not in (self._start, self._start + self._apart) or length > self._size:
            raise MessageError(f"a message of {length} bytes at {start}, where none is written")
        message = self._memory[start : start + length]
        if step_of(message) != step_of(place):
            raise MessageError("the shared memory holds another step there")
        return message


class SharedSteps:
    """The memory of one shard, as one of its two ends has it: it writes one direction and reads the other."""

    def __init__(self, memory: mmap.mmap, k: int, m: int, mark: int, plant: bool) -> None:
        """Write the mark of this end, which is the plant or the agent."""
        view, (state, own) = memoryview(memory), _sizes(k, m)
        states = _Rows(view, _MARKS_BYTES, state)
        inputs = _Rows(view, _MARKS_BYTES + 2 * _aligned(state), own)
        self._out, self._into = (states, inputs) if plant else (inputs, states)
        marks = np.frombuffer(memory, np.int64, 2)
        """of the plant and of the agent"""
        self._other: NDArray[np.int64] = marks[int(plant) :]
        marks[1 - plant] = mark

    def has(self, mark: int) -> bool:
        """Return True if the other end, with this mark, has opened the memory last."""
        return bool(self._other[0] == mark)

    def write(self, t: int, message: bytes) -> bytes:
        """Return the message to send for that of step t: its place, or itself if it has no room."""
        return self._out.write(t, message)

    def view(self, place: bytes) -> memoryview:
        """Return the message that a PLACE message names, in place; raise MessageError if it is not there."""
        return self._into.view(place)

    def copy(self, place: bytes) -> bytes:
        """Return a copy of that message; raise MessageError if it is not there, or is overwritten meanwhile."""
        view = self._into.view(place)
        message = bytes(view)
        if message[:HEADER_BYTES] != view[:HEADER_BYTES]:
            raise MessageError("the shared memory changed while it was read")
        return message


def open_steps(path: str, k: int, m: int, mark: int, plant: bool = False) -> SharedSteps | None:
    """Return the memory of a shard that another process created; None if it cannot be opened here."""
    memory = open_memory(path, _whole(k, m))
    return None if memory is None else SharedSteps(memory, k, m, mark, plant)
