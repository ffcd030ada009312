"""What an end of the wire remembers: the last rows of states, of inputs and of what was open; bounded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wire.codec import Array, Flags


class History:
    """Rows of consecutive steps, `first` .. `next` - 1, of which the oldest fall off past `most`.

    Room is made by doubling up to twice `most`, then by moving the last rows to the front: an append costs the same
    at any length, and any span of steps is one slice.
    """

    def __init__(self, most: int, states: int, inputs: int, bits: int) -> None:
        self.most = most
        self.first = self.next = 0
        self._at = 0
        """where `first` stands"""
        self._x, self._u = np.empty((0, states)), np.empty((0, inputs))
        self._bits = np.empty((0, bits), dtype=np.uint8)

    def append(self, x: Array, u: Array, bits: Flags) -> None:
        """The row of step `next`; nothing is kept where `most` is 0."""
        if not self.most:
            return
        end = self._at + self.next - self.first
        if end == len(self._x):
            end = self._make_room()
        self._x[end], self._u[end], self._bits[end] = x, u, bits
        self.next += 1
        if self.next - self.first > self.most:
            self.first += 1
            self._at += 1

    def _make_room(self) -> int:
        rows = self.next - self.first
        size = max(64, min(2 * self.most, 2 * rows))
        for name in ("_x", "_u", "_bits"):
            old: NDArray[np.float64] = getattr(self, name)
            new = np.empty((size, old.shape[1]), dtype=old.dtype)
            new[:rows] = old[self._at : self._at + rows]
            setattr(self, name, new)
        self._at = 0
        return rows

    def begin_at(self, first: int, after: int) -> None:
        """Start anew, with rows `first` .. `after` - 1 of which nothing is known yet."""
        self.first = self.next = first
        self._at = 0
        nothing = (np.full(self._x.shape[1], np.nan), np.full(self._u.shape[1], np.nan))
        closed = np.zeros(self._bits.shape[1], dtype=np.uint8)
        for _ in range(first, after):
            self.append(*nothing, closed)

    def _span(self, start: int, stop: int) -> slice:
        return slice(self._at + max(start, self.first) - self.first, self._at + min(stop, self.next) - self.first)

    def x(self, start: int, stop: int) -> Array:
        """The states of steps start .. stop - 1, as far as they are here, (S, states); a view."""
        return self._x[self._span(start, stop)]

    def u(self, start: int, stop: int) -> Array:
        """The inputs, likewise, (S, inputs)."""
        return self._u[self._span(start, stop)]

    def bits(self, start: int, stop: int) -> Flags:
        """The bits, likewise, (S, bits)."""
        return self._bits[self._span(start, stop)]
