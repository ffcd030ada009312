"""The undirected graph of a network, and the flow that inputs make over it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


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

    def flow(self, u: Array, edge_open: Mask) -> Array:
        """f_i = sum over neighbours j of (u_i - u_j), over the edges that are open, (n,); equation (1)."""
        difference = np.where(edge_open[self.edge], u[self.node] - u[self.neighbour], 0.0)
        return np.asarray(np.bincount(self.node, difference, self.n), dtype=float)

    def edge_input(self, u: Array, edge_open: Mask) -> Array:
        """u_e = u_j - u_i of each edge (i, j), 0 where it is closed, (E,); the paper's incidence matrix is -1 at i."""
        return np.where(edge_open, u[self.edges[:, 1]] - u[self.edges[:, 0]], 0.0)
