"""The samples of a few nodes that wait for rows of neighbours, in Python's floats.

A link that was down delivers all its missing rows once it is up, and a link that is late by k those up to t - k. So the
missing rows of a link are its newest ones. While every edge is open, the samples of a node that wait are then its
newest ones too, and no sample is learned twice. A step with a closed edge uses the general path (agents.samples).
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from hedgerow.agents.view import View
from hedgerow.wire.codec import link_inputs
from hedgerow.wire.message import LATE, MOST_LATE, TAKEN, Flag, Link, Span

MOST_WAITING = 32
"""the maximum number of samples that wait here; with more, the general path takes over"""

_OPEN, _RECEIVE = int(Flag.OPEN), int(Flag.RECEIVE)


class Row(NamedTuple):
    """A step: our states (k,), and the inputs, our own and then the peers' (width,), NaN where one is missing."""

    x: Sequence[float]
    u: list[float]


Arrival = tuple[int, int, Sequence[float]]
"""An incidence, the delay of its link, and the inputs of the neighbour in the rows that arrive over it.

The rows are all missing ones up to that of t - 1 - delay. There are no inputs if the neighbour is one of our own
nodes.
"""


class _Sender(NamedTuple):
    """The neighbour of an incidence: its peer, its place in the messages of this peer, and among the inputs of a row.

    The peer of one of our own nodes is -1.
    """

    peer: int
    place: int
    column: int


class Waiting:
    """The last rows of a shard, and the number of missing rows by incidence."""

    def __init__(self, view: View) -> None:
        self._receives = [peer.receives for peer in view.peers]
        places = [(-1, -1)] * view.k + [
            (p, place) for p, receives in enumerate(self._receives) for place in range(receives)
        ]
        columns: list[int] = view.column.tolist()
        self._senders = [_Sender(*places[column], column) for column in columns]
        self._node = view.row.tolist()
        self._k = view.k
        self.rows: deque[Row] = deque(maxlen=MOST_WAITING + 1)
        """the rows of the last steps, the newest last"""
        self.missing: list[int] = [0] * len(self._senders)
        """by incidence: the number of missing rows"""
        self.counts: list[int] = [0] * view.k
        """by node: the number of samples that wait"""
        self.most = 0
        """the greatest of these numbers"""

    def arrivals(
        self, past: int, links: Sequence[Link | bytes | None], flags: bytes, spans: Sequence[Span]
    ) -> list[Arrival] | None:
        """Return what arrives with the state of step `past` + 1; None if the general path has to take it.

        The general path takes it if an edge is closed, other rows arrive than the missing ones, a number is not
        finite, or a sample has waited too long.
        """
        if self.most >= MOST_WAITING:
            return None
        received = {c: (late, back) for c, late, back, _, _ in spans} if spans else {}
        newest_alone = (0, 0)
        found: list[Arrival] = []
        for c, (bits, missing, (peer, place, _)) in enumerate(zip(flags, self.missing, self._senders, strict=False)):
            if not bits & _RECEIVE:
                if not bits & _OPEN:
                    return None
                continue
            late, back = received.get(c, newest_alone)
            if late + back != missing or not bits & _OPEN:
                return None
            if peer < 0:
                found.append((c, late, ()))
                continue
            if (link := links[peer]) is None:
                return None
            receives = self._receives[peer]
            first, numbers = link_inputs(link) if isinstance(link, bytes) else _inputs(link)
            skipped = past - missing - first
            inputs = numbers[skipped * receives + place : (skipped + back + 1) * receives : receives]
            if skipped < 0 or len(inputs) != back + 1 or not isfinite(sum(inputs)):
                return None
            found.append((c, late, inputs))
        return found

    def fill(self, arrivals: Sequence[Arrival]) -> tuple[list[int], bytes]:
        """Write what arrives into the rows, of which the last is that of t - 1.

        Return the numbers of missing rows afterwards, and the Flag bits of the inputs used.
        """
        missing, used = [count + 1 for count in self.missing], bytearray([_OPEN]) * len(self.missing)
        for c, late, inputs in arrivals:
            if inputs:
                column, start = self._senders[c].column, -missing[c]
                for k, u in enumerate(inputs, start):
                    self.rows[k].u[column] = u
            if late:
                used[c] = _OPEN | min(missing[c] - late, MOST_LATE) << LATE
            else:
                used[c] = TAKEN | min(missing[c] - 1, MOST_LATE) << LATE
            missing[c] = late
        return missing, bytes(used)

    def counts_with(self, missing: Sequence[int]) -> list[int]:
        """Return the number of samples that wait, by node, if these numbers of rows are missing."""
        if self._k == 1:
            return [max(missing, default=0)]
        counts = [0] * self._k
        for node, count in zip(self._node, missing, strict=True):
            counts[node] = max(counts[node], count)
        return counts

    def enter(self, rows: Sequence[tuple[list[float], list[float], bytes]], unlearned: Sequence[int] | None) -> bool:
        """Take these last rows: states, inputs, and the Flag bits of the inputs used.

        `unlearned` are the numbers of steps since the last learned sample, by node; None if no sample waits. Return
        False if the rows that are missing are not the newest ones, or if a node has learned a later sample.
        """
        missing = [0] * len(self.missing)
        for _, _, bits in rows:
            for c, own in enumerate(bits):
                if own & _RECEIVE and not missing[c]:
                    continue
                if own != _OPEN:
                    return False
                missing[c] += 1
        counts = self.counts_with(missing)
        most = max(counts)
        if most >= min(len(rows), MOST_WAITING) or (unlearned is not None and unlearned != counts):
            return False
        # A sample that waits needs its readings and open edges.
        for x, _, bits in rows[len(rows) - most :]:
            if not (isfinite(sum(x)) and all(own & _OPEN for own in bits)):
                return False
        self.rows.clear()
        self.rows.extend(Row(x, u) for x, u, _ in rows)
        self.missing, self.counts, self.most = missing, counts, most
        return True

    def leave(self) -> tuple[list[tuple[Row, bytes]], list[int]]:
        """Return the rows with samples that wait, each with the Flag bits of the inputs that it has, and `counts`.

        No sample waits after that.
        """
        rows = [
            (self.rows[-age], bytes(_OPEN if count >= age else TAKEN for count in self.missing))
            for age in range(self.most, 0, -1)
        ]
        counts = self.counts
        self.missing, self.counts, self.most = [0] * len(self.missing), [0] * self._k, 0
        return rows, counts


def _inputs(link: Link) -> tuple[int, Sequence[float]]:
    """Return the first step of a link message, and all its inputs, row by row."""
    return link.first, struct.unpack(f"<{len(link.u) // 8}d", link.u)
