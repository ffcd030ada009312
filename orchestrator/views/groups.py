"""A large network in a picture: some hundred groups of neighbours, and the edges between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.topologies.graph import Graph, Index, Mask
from hedgerow.topologies.partition import partition

GROUPS = 500


class Scene(NamedTuple):
    """The data of a picture: the fields of a Batch with these names, R rows each."""

    t: NDArray[np.int64]
    x: NDArray[np.float64]
    missing: Mask
    dead: Mask
    wrong: Mask
    u_edge: NDArray[np.float64]
    edge_open: Mask
    link_up: Mask


class Groups:
    """Parts of equal size with few edges between them; the picture of a group shows its worst node.

    |x| and the flow of an edge are the maxima. An edge is cut, and a message lost, if this holds for one of them. A
    group is dead or without input if a node is. Its model is wrong if more than half of its nodes have wrong models.
    """

    def __init__(self, graph: Graph) -> None:
        parts = partition(graph, GROUPS)
        self._weights = graph.weights
        self.size = max(map(len, parts))
        """the approximate number of nodes in a group"""
        self._nodes = np.concatenate(parts)
        self._starts = np.cumsum([0, *map(len, parts)])[:-1]
        home = np.empty(graph.n, dtype=np.int64)
        home[self._nodes] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        low, high = np.sort(home[graph.edges], axis=1).T
        deliveries = np.flatnonzero(low != high)
        pairs, place = np.unique(low[deliveries] * len(parts) + high[deliveries], return_inverse=True)
        self.graph = Graph(len(parts), np.stack([pairs // len(parts), pairs % len(parts)], axis=1))
        self._edges = _Gathered(deliveries, place, len(pairs))
        outward = np.flatnonzero(home[graph.node] != home[graph.neighbour])
        own = self.graph.node * len(parts) + self.graph.neighbour
        at = np.searchsorted(own, home[graph.node[outward]] * len(parts) + home[graph.neighbour[outward]])
        self._links = _Gathered(outward, at, len(own))

    def name(self, group: int, ids: Sequence[int | str]) -> str:
        """Return the name of a group: that of its first node."""
        return f"{ids[int(self._nodes[self._starts[group]])]}…"

    def scene(self, batch: Batch, rows: Index) -> Scene:
        """Return some rows of a batch for the picture."""

        def of(values: NDArray[Any], most: np.ufunc = np.maximum) -> NDArray[Any]:
            return np.asarray(most.reduceat(values[:, self._nodes], self._starts, axis=1))

        size = np.diff(np.append(self._starts, len(self._nodes)))
        wrong = of(batch.wrong[rows].astype(np.int64), np.add) > size / 2
        return Scene(
            t=batch.t[rows],
            x=of(np.abs(batch.x[rows])),
            missing=of(batch.missing[rows], np.logical_or),
            dead=of(batch.dead[rows], np.logical_or),
            wrong=wrong,
            u_edge=self._edges.most(self._flow(batch.u_edge[rows])),
            edge_open=self._edges.all(batch.edge_open[rows]),
            link_up=self._links.all(batch.link_up[rows]),
        )

    def _flow(self, u_edge: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the magnitude k_e |u_e| of the flow over each edge."""
        size = np.abs(u_edge)
        return size if self._weights is None else size * self._weights


class _Gathered:
    """Columns of an array, ordered by place; each of `count` places has one or more."""

    def __init__(self, columns: Index, places: Index, count: int) -> None:
        order = np.argsort(places, kind="stable")
        self._columns = columns[order]
        self._starts = np.searchsorted(places[order], np.arange(count))

    def most(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the maximum of each place."""
        if not len(self._starts):
            return np.empty((len(values), 0))
        return np.asarray(np.maximum.reduceat(values[:, self._columns], self._starts, axis=1))

    def all(self, values: Mask) -> Mask:
        """Return True for each place with True in all of its columns."""
        if not len(self._starts):
            return np.empty((len(values), 0), dtype=np.bool_)
        return np.asarray(np.logical_and.reduceat(values[:, self._columns], self._starts, axis=1))
