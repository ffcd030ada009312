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
    """The first missing row of every link; both ends store at most `history` rows."""

    def __init__(self, graph: Graph, history: int) -> None:
        self._graph, self._history = graph, history
        self._lacks: Index = np.full(len(graph.node), -1)
        """the first missing row, -1 if it is that of the next step"""
        self.complete = True
        """True if no link has missing rows"""
        self.forgotten = 0
        """the number of rows that were no longer stored when their link came up again"""
        nothing: Index = np.zeros(len(graph.node), dtype=np.int64)
        self.whole = Deliveries(np.ones(len(graph.node), dtype=bool), nothing, nothing)
        """The deliveries of a step in which every link delivers the row of that step."""

    def plan(self, t: int, down: Mask, late: Index | None) -> Deliveries:
        """Return the rows that cross at step t, given the links that are down and the delays of late links."""
        nothing = self.whole.late
        if not self._history:  # without a history, missing rows stay missing and late rows are dropped
            return Deliveries(~down & (late == 0) if late is not None else ~down, nothing, nothing)
        late = nothing if late is None else late
        first = np.where(self._lacks < 0, t, self._lacks)
        kept = np.maximum(first, t - self._history + 1)
        some = ~down & (kept <= t - late)
        back = np.where(some, np.maximum(t - late - kept, 0), 0)
        return Deliveries(some, np.where(some, late, 0), back)

    def commit(self, t: int, deliveries: Deliveries | None) -> None:
        """Record the deliveries as done; None if every link delivers the row of the step alone."""
        if not self._history or (deliveries is None and self.complete):
            return
        deliveries = deliveries or self.whole
        first = np.where(self._lacks < 0, t, self._lacks)
        self.forgotten += int(np.maximum(t - self._history + 1 - first, 0)[deliveries.some].sum())
        after = np.where(deliveries.some, t + 1 - deliveries.late, first)
        self._lacks = np.where(after > t, -1, after)
        self.complete = bool((self._lacks < 0).all())

    def forget(self, nodes: Mask) -> None:
        """Mark every row of these nodes as missing again, because their agents lost their memory."""
        if self._history:
            self._lacks[nodes[self._graph.node]] = 0
            self.complete = False
