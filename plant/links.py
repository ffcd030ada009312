"""The rows of link messages that are delivered at a step, and those that are still missing.

A link is an incidence: node i receives messages from neighbour j over it. In step t, a link that is up delivers the row
of t, and before it all rows that were missing while it was down. A link that is late by k delivers its rows up to t -
k.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hedgerow.topologies.graph import Graph, Index, Mask


class Deliveries(NamedTuple):
    """The deliveries of the links at one step, (2E,) each: True if any row arrives, its delay, and the earlier rows
    with it.

    The newest row is that of t - late; `back` rows arrive before it.
    """

    some: Mask
    late: Index
    back: Index

    @property
    def fresh(self) -> Mask:
        """Return the links that deliver the row of the step itself."""
        return np.asarray(self.some & (self.late == 0))


class Links:
    """The number of missing rows of every link, always its newest ones; both ends store at most `history` rows."""

    def __init__(self, graph: Graph, history: int) -> None:
        self._graph, self._history = graph, history
        self._missing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self._stored = self._missing
        """of these rows, the number that is still stored"""
        self.complete = True
        """True if no link has missing rows"""
        self.forgotten = 0
        """the number of rows that were no longer stored when their link came up again"""
        nothing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self.whole = Deliveries(np.ones(len(graph.node), dtype=bool), nothing, nothing)
        """The deliveries of a step in which every link delivers the row of that step."""

    def plan(self, down: Mask, late: Index | None) -> Deliveries:
        """Return the rows that cross at this step, given the links that are down and the delays of late links."""
        nothing = self.whole.late
        if not self._history:  # without a history, missing rows stay missing and late rows are dropped
            return Deliveries(~down & (late == 0) if late is not None else ~down, nothing, nothing)
        self._stored = np.minimum(self._missing, self._history - 1)
        if late is None:
            some = ~down
            return Deliveries(some, nothing, self._stored * some)
        some = ~down & (late <= self._stored)
        return Deliveries(some, late * some, (self._stored - late) * some)

    def commit(self, deliveries: Deliveries | None) -> None:
        """Record the deliveries of the step as done; None if every link delivers the row of the step alone."""
        if not self._history or (deliveries is None and self.complete):
            return
        deliveries = deliveries or self.whole
        if self._missing.max(initial=0) >= self._history:
            self.forgotten += int((self._missing - self._stored)[deliveries.some].sum())
        self._missing = np.where(deliveries.some, deliveries.late, self._missing + 1)
        self.complete = not self._missing.any()

    def forget(self, nodes: Mask, t: int) -> None:
        """Mark every row of these nodes before step t as missing again, because their agents lost their memory."""
        if self._history:
            self._missing[nodes[self._graph.node]] = t
            self.complete = False
