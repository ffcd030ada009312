"""The input messages of one step, as arrays of the network.

Almost always every shard sends the header of the step and u, ahat and margin of its nodes. Flag bits follow if messages
were lost. Such messages stay bytes until all are here. One join and one look then give the numbers of every node.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hedgerow.topologies.graph import Array, Index
from hedgerow.wire.codec import HEADER_BYTES, decode_input, gather, header
from hedgerow.wire.message import REPORT_ROWS, Buffer, Input, Kind

TOGETHER = 4096
"""nodes up to which messages are joined whole; the copies of larger ones would delay the next states"""


class Inputs:
    """The inputs of the shards at step t: `take` messages, read `u`, `begin` the next step, read `rest`."""

    def __init__(self, sizes: Sequence[int], incidences: Sequence[int]) -> None:
        """`sizes` are the numbers of nodes and `incidences` those of the incidences, by shard."""
        self._sizes, self._incidences = sizes, incidences
        self._lengths = [HEADER_BYTES + 8 * (1 + REPORT_ROWS) * k for k in sizes]
        self._together = sum(sizes) <= TOGETHER
        nothing = [np.full(k, np.nan).tobytes() for k in sizes]
        self._silence = [Input(-1, nan, nan, nan, bytes(m)) for nan, m in zip(nothing, incidences, strict=True)]
        self._t, self._heads = -1, [b""] * len(sizes)
        self._messages: list[bytes | memoryview] = [b""] * len(sizes)
        """By shard: the message; empty while there is none."""
        self._regular = 0
        """number of messages with the expected header and length"""
        self._with_bits = False
        """True if one of them has Flag bits"""
        self._took: Sequence[Buffer] = ()
        """By shard: the Flag bits of the last step; empty if there are none."""
        self._row: Array | None = None
        """all numbers of the last step, headers included; None if its messages were taken apart one by one"""
        self._parts: Sequence[Input] = ()
        """By shard: the message of the last step if they were."""
        self._at: Index = _places(sizes if self._together else ())
        """By node, in the order of the shards: the places of u, ahat and margin in `_row`, (1 + REPORT_ROWS, n)."""

    def begin(self, t: int) -> None:
        """Wait for the inputs of step t; a shard without one is silent."""
        self._t, self._messages, self._regular, self._with_bits = t, [b""] * len(self._sizes), 0, False
        heads = {k: header(Kind.INPUT, k, t) for k in set(self._sizes)}
        self._heads = [heads[k] for k in self._sizes]

    def take(self, p: int, message: bytes | memoryview) -> bool:
        """Keep the message of shard p, once per step; return False if it is of another step. Raises MessageError.

        A view of shared memory must stay as it is until `rest` is read.
        """
        bits = len(message) - self._lengths[p]
        if (bits in (0, self._incidences[p])) and message[:HEADER_BYTES] == self._heads[p]:
            self._regular += 1
            if bits:
                self._with_bits = True
        elif decode_input(message, self._sizes[p], self._incidences[p]).t != self._t:
            return False
        self._messages[p] = message
        return True

    def u(self) -> Array:
        """Return the inputs of the step, (n,), in the order of the shards, NaN where a shard is silent."""
        if self._together and self._regular == len(self._messages):
            messages: Sequence[bytes | memoryview] = self._messages
            self._took = ()
            if self._with_bits:
                self._took = [message[length:] for message, length in zip(messages, self._lengths, strict=True)]
                messages = [message[:length] for message, length in zip(messages, self._lengths, strict=True)]
            self._row = np.frombuffer(b"".join(messages))
            u: Array = self._row.take(self._at[0])
            return u
        self._row = None
        self._parts = [
            decode_input(message, k, m) if message else silence
            for message, k, m, silence in zip(self._messages, self._sizes, self._incidences, self._silence, strict=True)
        ]
        return gather([one.u for one in self._parts])

    def rest(self) -> tuple[Array, Sequence[Buffer]]:
        """Return the reports, (REPORT_ROWS, n), and by shard the Flag bits taken in, of the step of the last `u`.

        Empty flags mean that everything was taken in. `begin` may have been called since.
        """
        if self._row is not None:
            return self._row.take(self._at[1:]), self._took
        reports = [*[one.ahat for one in self._parts], *[one.margin for one in self._parts]]
        return gather(reports).reshape(REPORT_ROWS, -1), [one.used for one in self._parts]


def _places(sizes: Sequence[int]) -> Index:
    """Return the places of u, ahat and margin of every node in such messages, one after the other."""
    rows: list[list[int]] = [[] for _ in range(1 + REPORT_ROWS)]
    start = 0
    for k in sizes:
        start += HEADER_BYTES // 8
        for row in rows:
            row.extend(range(start, start + k))
            start += k
    return np.array(rows, dtype=np.int64)
