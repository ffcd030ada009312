"""What an end of the wire remembers: the last rows of states, of inputs and of what was open; bounded."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hedgerow.wire.codec import Array, Flags

ASIDE = 64
"""how many short rows are laid aside at most"""
LONG = 4096
"""numbers in a row that is long: to lay it aside is to keep what is there anyway"""


class History:
    """Rows of consecutive steps, `first` .. `next` - 1, of which the oldest fall off past `most`.

    Room is made by doubling up to twice `most`, then by moving the last rows to the front: an append costs the same
    at any length, and any span of steps is one slice. But first a row is laid aside, until there are some or, if it is
    long, until somebody looks: most runs never do. So what is appended must not change afterwards.
    """

    def __init__(self, most: int, states: int, inputs: int, bits: int) -> None:
        self.most = most
        self.first = self.next = 0
        self._at = 0
        """where `first` stands"""
        self._x, self._u = np.empty((0, states)), np.empty((0, inputs))
        self._bits = np.empty((0, bits), dtype=np.uint8)
        self._background: deque[tuple[Array | Sequence[float], Array | Sequence[float], Flags]] = deque()
        """the last rows, which do not stand in the arrays yet"""
        self._patience = min(ASIDE, most) if states + inputs < LONG else most + 1

    def append(self, x: Array | Sequence[float], u: Array | Sequence[float], bits: Flags) -> None:
        """The row of step `next`; nothing is kept where `most` is 0."""
        if not self.most:
            return
        self._background.append((x, u, bits))
        self.next += 1
        if self.next - self.first > self.most:
            if len(self._background) == self.next - self.first:
                self._background.popleft()
            else:
                self._at += 1
            self.first += 1
        if len(self._background) == self._patience:
            self._settle()

    def _settle(self) -> None:
        """Put what was laid aside where it belongs."""
        if not (new := len(self._background)):
            return
        rows = self.next - self.first - new  # of those in the arrays, the oldest may have fallen off already
        if self._at + rows + new > len(self._x):
            self._make_room(rows, new)
        end = slice(self._at + rows, self._at + rows + new)
        self._x[end], self._u[end], self._bits[end] = zip(*self._background, strict=True)
        self._background.clear()

    def _make_room(self, rows: int, new: int) -> None:
        size = min(2 * self.most, max(64, 2 * (rows + new)))
        for name in ("_x", "_u", "_bits"):
            old: NDArray[np.float64] = getattr(self, name)
            larger = np.empty((size, old.shape[1]), dtype=old.dtype)
            larger[:rows] = old[self._at : self._at + rows]
            setattr(self, name, larger)
        self._at = 0

    def begin_at(self, first: int, after: int) -> None:
        """Start anew, with rows `first` .. `after` - 1 of which nothing is known yet."""
        self.first = self.next = first
        self._at = 0
        self._background.clear()
        nothing = (np.full(self._x.shape[1], np.nan), np.full(self._u.shape[1], np.nan))
        closed = np.zeros(self._bits.shape[1], dtype=np.uint8)
        for _ in range(first, after):
            self.append(*nothing, closed)

    def _span(self, start: int, stop: int) -> slice:
        self._settle()
        begin, end = (min(max(step, self.first), self.next) - self.first for step in (start, stop))
        return slice(self._at + begin, self._at + end)

    def x(self, start: int, stop: int) -> Array:
        """The states of steps start .. stop - 1, as far as they are here, (S, states); a view."""
        span = self._span(start, stop)
        return self._x[span]

    def u(self, start: int, stop: int) -> Array:
        """The inputs, likewise, (S, inputs)."""
        span = self._span(start, stop)
        return self._u[span]

    def bits(self, start: int, stop: int) -> Flags:
        """The bits, likewise, (S, bits)."""
        span = self._span(start, stop)
        return self._bits[span]
