"""The bounded history of one end of a connection: the last rows of states, inputs and flag bits."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hedgerow.wire.message import Array, Flags

QUEUED_ROWS = 64
"""The maximum number of short rows in the queue."""
LONG = 4096
"""The length from which a row counts as long.

A long row costs no extra memory in the queue, because its arrays exist anyway.
"""


class History:
    """The last rows of consecutive steps, `first` to `next` - 1; the oldest drop out when there are more than `most`.

    The arrays double up to a length of 2 `most`; then the last rows move to the front. So an append has the same cost
    at any length, and any span of steps is one slice. A new row waits in a queue first. The queue is written to the
    arrays when it is full or, for long rows, when a reader asks; most runs have no reader. So an appended row must not
    change afterwards. It is no `BoundedQueue`, because a reader takes any span of steps and removes nothing.
    """

    def __init__(self, most: int, states: int, inputs: int, bits: int) -> None:
        self.most = most
        self.first = self.next = 0
        self._at = 0
        """the position of `first` in the arrays"""
        self._x, self._u = np.empty((0, states)), np.empty((0, inputs))
        self._bits = np.empty((0, bits), dtype=np.uint8)
        self._queue: deque[tuple[Array | Sequence[float], Array | Sequence[float], Flags]] = deque()
        """the last rows, which are not in the arrays yet"""
        self._queued_rows = min(QUEUED_ROWS, most) if states + inputs < LONG else most + 1

    def append(self, x: Array | Sequence[float], u: Array | Sequence[float], bits: Flags) -> None:
        """Append the row of step `next`; store nothing if `most` is 0."""
        if not self.most:
            return
        self._queue.append((x, u, bits))
        self.next += 1
        if self.next - self.first > self.most:
            if len(self._queue) == self.next - self.first:
                self._queue.popleft()
            else:
                self._at += 1
            self.first += 1
        if len(self._queue) == self._queued_rows:
            self._settle()

    def drop_last(self, count: int) -> None:
        """Drop the last `count` rows, at most all."""
        self._settle()
        self.next -= count

    def _settle(self) -> None:
        """Write the queued rows to the arrays."""
        if not (new := len(self._queue)):
            return
        rows = self.next - self.first - new  # of the rows in the arrays, the oldest may have dropped out
        if self._at + rows + new > len(self._x):
            self._make_room(rows, new)
        end = slice(self._at + rows, self._at + rows + new)
        self._x[end], self._u[end], self._bits[end] = zip(*self._queue, strict=True)
        self._queue.clear()

    def _make_room(self, rows: int, new: int) -> None:
        size = min(2 * self.most, max(64, 2 * (rows + new)))
        for name in ("_x", "_u", "_bits"):
            old: NDArray[np.float64] = getattr(self, name)
            larger = np.empty((size, old.shape[1]), dtype=old.dtype)
            larger[:rows] = old[self._at : self._at + rows]
            setattr(self, name, larger)
        self._at = 0

    def begin_at(self, first: int, after: int) -> None:
        """Restart the history with rows `first` to `after` - 1, which are unknown (NaN, no bits)."""
        self.first = self.next = first
        self._at = 0
        self._queue.clear()
        nothing = (np.full(self._x.shape[1], np.nan), np.full(self._u.shape[1], np.nan))
        closed = np.zeros(self._bits.shape[1], dtype=np.uint8)
        for _ in range(first, after):
            self.append(*nothing, closed)

    def _span(self, start: int, stop: int) -> slice:
        self._settle()
        begin, end = (min(max(step, self.first), self.next) - self.first for step in (start, stop))
        return slice(self._at + begin, self._at + end)

    def x(self, start: int, stop: int) -> Array:
        """Return the states of steps start to stop - 1, as far as they are stored, (S, states); a view."""
        span = self._span(start, stop)
        return self._x[span]

    def u(self, start: int, stop: int) -> Array:
        """Return the inputs of the same steps, (S, inputs)."""
        span = self._span(start, stop)
        return self._u[span]

    def bits(self, start: int, stop: int) -> Flags:
        """Return the flag bits of the same steps, (S, bits)."""
        span = self._span(start, stop)
        return self._bits[span]
