"""Which process has which nodes: parts of one size, between which few edges cross."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np

from hedgerow.topologies.graph import Graph, Index, Mask

IN_ORDER = 64
"""Networks of up to so many nodes, which people write, are cut in the order of the file."""


@lru_cache(maxsize=8)
def partition(graph: Graph, processes: int) -> tuple[Index, ...]:
    """Positions of nodes by process, ascending; a function of the graph alone.

    Blocks of the order, among three, that the fewest edges cross: the file's own; reverse Cuthill-McKee, which cuts a
    band across; and depth first, in which all that hangs below a node of a tree stands together.
    """
    in_order = _blocks(np.arange(graph.n), processes)
    if graph.n <= IN_ORDER or processes in (1, graph.n) or not cut(graph, in_order):
        return in_order
    # Half a second to load, and only large networks need it.
    from scipy.sparse.csgraph import depth_first_order, reverse_cuthill_mckee  # noqa: PLC0415

    banded = reverse_cuthill_mckee(_beside(graph), symmetric_mode=True)
    deep = depth_first_order(_beside(graph, pieces(graph)), graph.n, return_predecessors=False)
    return min((in_order, *(_blocks(order, processes) for order in (banded, deep[1:]))), key=partial(cut, graph))


def pieces(graph: Graph) -> Index:
    """A node of each connected piece of the graph."""
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    _, piece = connected_components(_beside(graph), directed=False)
    _, first = np.unique(piece, return_index=True)
    return first


def _beside(graph: Graph, roots: Index | None = None) -> Any:
    """The adjacency matrix; with `roots`, of one node more, behind all others, which leads to those."""
    import scipy.sparse  # noqa: PLC0415

    to, first = graph.neighbour, graph.first
    if roots is not None:
        to, first = np.append(to, roots), np.append(first, first[-1] + len(roots))
    n = len(first) - 1
    return scipy.sparse.csr_array((np.ones(len(to), np.int8), to, first), (n, n))


def _blocks(order: Index, processes: int) -> tuple[Index, ...]:
    return tuple(np.sort(block).astype(np.int64) for block in np.array_split(order, processes))


def cut(graph: Graph, parts: tuple[Index, ...]) -> int:
    """How many edges cross from one part to another: a message costs the same, whatever the edge weighs."""
    return int(_crossing(graph, parts).sum())


def cut_weight(graph: Graph, parts: tuple[Index, ...]) -> float:
    """The sum of the weights of the edges that cross from one part to another."""
    crossing = _crossing(graph, parts)
    return float(crossing.sum() if graph.weights is None else graph.weights[crossing].sum())


def _crossing(graph: Graph, parts: tuple[Index, ...]) -> Mask:
    home = np.empty(graph.n, dtype=np.int64)
    home[np.concatenate(parts)] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return np.asarray(home[graph.edges[:, 0]] != home[graph.edges[:, 1]])
