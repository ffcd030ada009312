"""The plant of a network as the bounds on the gain of its law see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hedgerow.topologies.graph import Array, Index


@dataclass(frozen=True)
class PlantModel:
    """The numbers of a network that a bound depends on."""

    a: Array
    """the truth, (n,)"""
    b: Array
    """gains, (n,)"""
    edges: Index
    """pairs of nodes, (E, 2)"""
    root_weights: Array
    """sqrt(k_e), (E,)"""
    lowest: Array
    """the smallest candidate per node, (n,)"""
    highest: Array
    """the largest candidate per node, (n,)"""

    @classmethod
    def of(
        cls, a: Array, b: float | Array, edges: Index, weights: Array | None, lowest: Array, highest: Array
    ) -> PlantModel:
        """Return the plant of a network with gains b (one, or one per node) and weights (None: all 1)."""
        root = np.ones(len(edges)) if weights is None else np.sqrt(weights)
        return cls(a, np.broadcast_to(np.asarray(b, dtype=float), a.shape), edges, root, lowest, highest)

    @property
    def n(self) -> int:
        """Return the number of nodes."""
        return len(self.a)

    def incidence(self) -> Array:
        """Return B = diag(b) incidence diag(sqrt k), (n, E)."""
        found = np.zeros((self.n, len(self.edges)))
        column = np.arange(len(self.edges))
        for end, sign in ((0, 1.0), (1, -1.0)):
            node = self.edges[:, end]
            found[node, column] = sign * self.b[node] * self.root_weights
        return found
