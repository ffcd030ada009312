"""The undirected graph of a network, and the flow that inputs make over it."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.fast import kernels_for

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

FEW = 32
"""so many numbers are summed faster without numpy"""
LARGEST = 1e100
"""of any number of a file: sums of squares of those that are no larger do not overflow"""


def all_finite(values: Array) -> bool:
    """Whether all of them are finite; where even their sum is not, it may say no."""
    return math.isfinite(sum(values.tolist()) if values.size <= FEW else np.add.reduce(values))


def starts(node: Index, n: int) -> Index:
    """Where the incidences of each of n nodes begin in a list that is ordered by node, and its length, (n + 1,)."""
    return np.concatenate([[0], np.cumsum(np.bincount(node, minlength=n))])


class Graph:
    """Nodes 0 .. n-1 and undirected edges, each once.

    An edge seen from one of its ends is an *incidence*; there are 2E of them, ordered by node and then by
    neighbour. Every sum over neighbours runs in that order, so that it gives the same bits wherever it is
    taken: in the plant, in a shard of one node or in a shard of all.
    """

    def __init__(self, n: int, edges: Index) -> None:
        self.n = n
        self.edges = edges
        ends = np.concatenate([edges, edges[:, ::-1]])
        order = np.lexsort((ends[:, 1], ends[:, 0]))
        self.node: Index = ends[order, 0]
        """Per incidence: the end it is seen from."""
        self.neighbour: Index = ends[order, 1]
        """Per incidence: the other end."""
        self.edge: Index = np.tile(np.arange(len(edges)), 2)[order]
        """Per incidence: which row of `edges` it belongs to."""

    @cached_property
    def degree(self) -> Index:
        """d_i, the number of neighbours of each node, (n,)."""
        return np.bincount(self.node, minlength=self.n)

    @cached_property
    def first(self) -> Index:
        """Where the incidences of each node begin, and behind them their number, (n + 1,)."""
        return starts(self.node, self.n)

    def joins(self, i: int, j: int) -> bool:
        """Whether an edge joins two nodes."""
        return bool((self.neighbour[self.first[i] : self.first[i + 1]] == j).any())

    @cached_property
    def reverse(self) -> Index:
        """Per incidence: the same edge seen from its other end, (2E,)."""
        order = np.lexsort((self.node, self.neighbour))
        place = np.empty_like(order)
        place[np.arange(len(order))] = order
        return place

    def flow(self, u: Array, edge_open: Mask | None = None) -> Array:
        """f_i = sum over neighbours j of (u_i - u_j), over the edges that are open; equation (1).

        u: (n,), or (B, n) for B networks at once; edge_open: (E,), or (B, E), None where all are open; f: as u.
        """
        if edge_open is None and (kernels := kernels_for(self.n)) is not None:
            if u.ndim == 1:
                return kernels.flow(self.first, self.neighbour, u)  # type: ignore[no-any-return]
            return np.array([kernels.flow(self.first, self.neighbour, row) for row in u])
        difference = u.take(self.node, axis=-1) - u.take(self.neighbour, axis=-1)
        if edge_open is not None:
            difference = np.where(edge_open.take(self.edge, axis=-1), difference, 0.0)
        if u.ndim == 1:
            return np.bincount(self.node, difference, self.n)  # type: ignore[return-value]  # weighted: floats
        node = self.node + self.n * np.arange(len(u))[:, None]
        flows: Array = np.bincount(node.ravel(), difference.ravel(), u.size)  # type: ignore[assignment]
        return flows.reshape(u.shape)

    def edge_input(self, u: Array, edge_open: Mask | None = None) -> Array:
        """u_e = u_j - u_i of each edge (i, j), 0 where it is closed; the paper's incidence matrix is -1 at i.

        Shapes as in `flow`, with E columns in place of n.
        """
        difference = u.take(self.edges[:, 1], axis=-1) - u.take(self.edges[:, 0], axis=-1)
        return difference if edge_open is None else np.where(edge_open, difference, 0.0)
