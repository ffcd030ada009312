"""The part of the state messages that is about links: Flag bits and spans by shard, for one step or several at once."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hedgerow.plant.links import Deliveries
from hedgerow.topologies.graph import Graph, Index
from hedgerow.wire.message import ALL_UP, Flag, Flags, Span

_NO_SPANS = np.empty((0, len(Span._fields)), dtype=np.uint32)
_SPAN = struct.Struct(f"<{len(Span._fields)}I")


class Places:
    """The incidences of the shards: those of the first shard, then those of the next, each in the shard's order."""

    def __init__(self, graph: Graph, shard_of: Index, shards: int) -> None:
        """`shard_of` is the shard of each node, (n,)."""
        home = shard_of[graph.node]
        self.graph = graph
        self.order: Index = home.argsort(kind="stable")
        """the incidences in this order, (2E,)"""
        self.stops: list[int] = np.bincount(home, minlength=shards).cumsum().tolist()
        """by shard: the end of its incidences in this order"""
        self.up = [bytes([ALL_UP]) * count for count in np.bincount(home, minlength=shards).tolist()]
        """by shard: its Flag bits if all are set"""
        self.shard: Index = home[self.order]
        self.local: Index = np.arange(len(home)) - np.array([0, *self.stops])[self.shard]
        """by place in this order: the shard, and the place within the shard, (2E,)"""


class LinkStates:
    """The Flag bits and spans of all shards at S steps."""

    def __init__(self, places: Places, edge_open: Flags | None, received: Deliveries, sent: Deliveries) -> None:
        """Take the deliveries of the steps, `sent`, and of the steps before them, `received`, (S, 2E) each.

        `edge_open` (E,) are the edges that were open before the first step; None for all. All are open after that.
        """
        graph, reverse = places.graph, places.graph.reverse
        self._places, self._shards = places, len(places.stops)
        opened: Flags = np.full(received.some.shape, Flag.OPEN, dtype=np.uint8)
        if edge_open is not None:
            opened[0] = edge_open.take(graph.edge)
        arriving: Flags = np.left_shift(received.some, 1, dtype=np.uint8)
        leaving: Flags = np.left_shift(sent.some.take(reverse, axis=1), 2, dtype=np.uint8)
        self.flags: Flags = opened | arriving | leaving
        """Flag bits by incidence, (S, 2E)"""
        self._bits = self.flags.take(places.order, axis=1)
        self._spans: NDArray[np.uint32] = _NO_SPANS
        """the spans of all steps and shards, (K, 5)"""
        self._stops = [0] * (len(self.flags) * self._shards)
        """by step and shard: the end of its spans"""
        columns = (received.late, received.back, sent.late.take(reverse, axis=1), sent.back.take(reverse, axis=1))
        some = columns[0] | columns[1] | columns[2] | columns[3]
        if some.any():
            self._note_spans(some, columns)
        self._made, self._tails = -1, list[bytes]()
        """the last step that `tails` was called for, and the result"""

    def _note_spans(self, some: Index, columns: Sequence[Index]) -> None:
        """Note the spans of the incidences where `some` is not 0; `columns` are the numbers of a span, (S, 2E) each."""
        places = self._places
        steps, found = some.take(places.order, axis=1).nonzero()
        incidences = places.order[found]
        numbers = [places.local[found], *(one[steps, incidences] for one in columns)]
        self._spans = np.stack(numbers, axis=1).astype(np.uint32)
        shards = steps * self._shards + places.shard[found]
        self._stops = np.bincount(shards, minlength=len(self._stops)).cumsum().tolist()

    def tails(self, k: int) -> list[bytes]:
        """Return, by shard, its state message of step k behind the states; empty if all bits are set, without spans.

        A second call for the same step is quick.
        """
        if self._made != k:
            self._made, self._tails = k, [bits + spans for bits, spans in self._parts(k)]
        return self._tails

    def parts(self, k: int) -> list[tuple[bytes, Sequence[Span]]]:
        """Return the same as Flag bits and spans."""
        return [(bits, [Span(*numbers) for numbers in _SPAN.iter_unpack(spans)]) for bits, spans in self._parts(k)]

    def _parts(self, k: int) -> list[tuple[bytes, bytes]]:
        all_bits, parts = self._bits[k].tobytes(), list[tuple[bytes, bytes]]()
        first = self._shards * k
        start = start_of_spans = 0
        last = self._stops[first - 1] if first else 0
        all_spans = self._spans[last : self._stops[first + self._shards - 1]].astype("<u4").tobytes()
        for up, stop, stop_of_spans in zip(
            self._places.up, self._places.stops, self._stops[first : first + self._shards], strict=True
        ):
            end_of_spans = _SPAN.size * (stop_of_spans - last)
            bits, spans = all_bits[start:stop], all_spans[start_of_spans:end_of_spans]
            parts.append((b"" if bits == up and not spans else bits, spans))
            start, start_of_spans = stop, end_of_spans
        return parts
