"""The undirected graph of a network, and the flow over its edges."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.fast import kernels_for, unequal_kernels_for

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Gain = float | Array
"""b of (1): one number for all nodes, or b_i of each, (n,)."""

FEW = 32
"""up to this many numbers, a sum without numpy is faster"""
MANY = 10_000
"""Up to this many numbers, a sum of squares is the fastest sum. For more of them, OpenBLAS may start threads."""
LARGEST = 1e100
"""the largest number in a file: sums of squares up to it do not overflow"""


def all_finite(values: Array) -> bool:
    """Return True if all values (n,) are finite; it may return False if only their sum or a square overflows."""
    if values.size <= FEW:
        return math.isfinite(sum(values.tolist()))
    return math.isfinite(values.dot(values) if values.size <= MANY else np.add.reduce(values))


def starts(node: Index, n: int) -> Index:
    """Return the index of the first incidence of each of n nodes in a list ordered by node, and its length, (n +
    1,).
    """
    return np.concatenate([[0], np.cumsum(np.bincount(node, minlength=n))])


def weighted_sums(node: Index, values: Array, n: int) -> Array:
    """Return the sum of values over the incidences of each of n nodes, in their order, (n,)."""
    return np.bincount(node, values, n).astype(float, copy=False)  # without incidences, bincount counts in integers


class Graph:
    """Nodes 0 .. n-1 and undirected edges, each once.

    An edge seen from one of its ends is an *incidence*; there are 2E of them, ordered by node and then by neighbour.
    Every sum over neighbours runs in that order. So it has the same bits in the plant, in a shard of one node and in a
    shard of all nodes.

    `weights` (E,) are k_e > 0 of the edges. None means that all are 1: then no step multiplies by them.
    """

    def __init__(self, n: int, edges: Index, weights: Array | None = None) -> None:
        self.n = n
        self.edges = edges
        self.weights = weights
        ends = np.concatenate([edges, edges[:, ::-1]])
        order = np.lexsort((ends[:, 1], ends[:, 0]))
        self.node: Index = ends[order, 0]
        """Per incidence: the node."""
        self.neighbour: Index = ends[order, 1]
        """Per incidence: the other end."""
        self.edge: Index = np.tile(np.arange(len(edges)), 2)[order]
        """Per incidence: its row in `edges`."""

    def __repr__(self) -> str:
        return f"<Graph: {self.n} nodes, {len(self.edges)} edges>"

    @cached_property
    def degree(self) -> Index:
        """Return d_i, the number of neighbours of each node, (n,)."""
        return np.bincount(self.node, minlength=self.n)

    @cached_property
    def weight(self) -> Array | None:
        """Return the weight of each incidence's edge, (2E,); None if all are 1."""
        return None if self.weights is None else self.weights[self.edge]

    @cached_property
    def weighted_degree(self) -> Index | Array:
        """Return d_i, the sum of the weights of the edges of each node, (n,); if all are 1, the degree in whole
        numbers.
        """
        return self.degree if self.weight is None else weighted_sums(self.node, self.weight, self.n)

    @cached_property
    def first(self) -> Index:
        """Return the index of the first incidence of each node, and the number of all, (n + 1,)."""
        return starts(self.node, self.n)

    def joins(self, i: int, j: int) -> bool:
        """Return True if an edge joins two nodes."""
        return bool((self.neighbour[self.first[i] : self.first[i + 1]] == j).any())

    @cached_property
    def reverse(self) -> Index:
        """Return, per incidence, the same edge seen from its other end, (2E,)."""
        order = np.lexsort((self.node, self.neighbour))
        place = np.empty_like(order)
        place[np.arange(len(order))] = order
        return place

    def flow(self, u: Array, edge_open: Mask | None = None) -> Array:
        """Return f_i = sum over neighbours j of k_ij (u_i - u_j), over the open edges; equation (1).

        u: (n,), or (B, n) for B networks at once; edge_open: (E,), or (B, E), None if all are open; f: as u.
        """
        if edge_open is None and (kernels := kernels_for(self.n)) is not None:
            if u.ndim > 1:
                return np.array([self.flow(row) for row in u])
            if self.weight is None:
                return kernels.flow(self.first, self.neighbour, u)  # type: ignore[no-any-return]
            if (unequal := unequal_kernels_for(self.n)) is not None:
                return unequal.flow(self.first, self.neighbour, self.weight, u)  # type: ignore[no-any-return]
        difference = u.take(self.node, axis=-1) - u.take(self.neighbour, axis=-1)
        if self.weight is not None:
            difference *= self.weight
        if edge_open is not None:
            difference = np.where(edge_open.take(self.edge, axis=-1), difference, 0.0)
        if u.ndim == 1:
            return np.bincount(self.node, difference, self.n)  # type: ignore[return-value]  # weighted: floats
        node = self.node + self.n * np.arange(len(u))[:, None]
        flows: Array = np.bincount(node.ravel(), difference.ravel(), u.size)  # type: ignore[assignment]
        return flows.reshape(u.shape)

    def edge_input(self, u: Array, edge_open: Mask | None = None) -> Array:
        """Return u_e = u_j - u_i of each edge (i, j), 0 if it is closed; the paper's incidence matrix is -1 at i.

        Shapes as in `flow`, with E columns in place of n.
        """
        difference = u.take(self.edges[:, 1], axis=-1) - u.take(self.edges[:, 0], axis=-1)
        return difference if edge_open is None else np.where(edge_open, difference, 0.0)

    def edge_cost(self, u_edge: Array) -> Array:
        """Return the cost sum_e k_e u_e^2 of edge inputs (B, E), as (B,)."""
        squares = u_edge * u_edge
        if self.weights is not None:
            squares *= self.weights
        return np.asarray(squares.sum(axis=-1))
