"""The assignment of nodes to processes: parts of equal size with few edges between them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from hedgerow.topologies.graph import Graph, Index, Mask

IN_ORDER = 64
"""Networks up to this number of nodes, which people write by hand, are cut in the order of the file."""


def parts_of(graph: Graph, processes: int, layout: Sequence[int] | None) -> tuple[Index, ...]:
    """Return the positions of nodes by process, ascending: those of a layout for `processes`, otherwise a partition.

    layout: the process of each node, from 0, (n,), as a resolved file records it; None if nothing is recorded.
    """
    if layout is None or max(layout) + 1 != processes:
        return partition(graph, processes)
    home = np.asarray(layout, dtype=np.int64)
    order = home.argsort(kind="stable")
    return tuple(np.split(order, np.cumsum(np.bincount(home, minlength=processes))[:-1]))


def layout_of(graph: Graph, processes: int) -> tuple[int, ...] | None:
    """Return the process of each node, (n,), where METIS may decide it; None where the order of the nodes does."""
    if graph.n <= IN_ORDER or processes in (1, graph.n):
        return None
    home = np.empty(graph.n, dtype=np.int64)
    for process, nodes in enumerate(partition(graph, processes)):
        home[nodes] = process
    return tuple(home.tolist())


@lru_cache(maxsize=8)
def partition(graph: Graph, processes: int) -> tuple[Index, ...]:
    """Return the positions of the nodes of each process, ascending; a function of the graph alone.

    The result is the best of four cuts, the one with the fewest crossing edges. Three cuts divide an order into blocks:
    the order of the file; reverse Cuthill-McKee, which cuts a band across; and depth first, which puts a branch of a
    tree together. The fourth cut is that of METIS, if it is installed: on random graphs, half as many edges cross.
    """
    in_order = _blocks(np.arange(graph.n), processes)
    if graph.n <= IN_ORDER or processes in (1, graph.n) or not cut(graph, in_order):
        return in_order
    return min((*by_orders(graph, processes), *_by_metis(graph, processes)), key=partial(cut, graph))


def by_orders(graph: Graph, processes: int) -> list[tuple[Index, ...]]:
    """Return the blocks of the three orders of `partition`."""
    # Load it here: it takes half a second, and only large networks need it.
    from scipy.sparse.csgraph import depth_first_order, reverse_cuthill_mckee  # noqa: PLC0415

    banded = reverse_cuthill_mckee(_beside(graph), symmetric_mode=True)
    deep = depth_first_order(_beside(graph, pieces(graph)), graph.n, return_predecessors=False)
    return [_blocks(order, processes) for order in (np.arange(graph.n), banded, deep[1:])]


def _by_metis(graph: Graph, processes: int) -> list[tuple[Index, ...]]:
    """Return the parts of METIS, made equal, the one with the first node first; an empty list if it is not
    installed.
    """
    try:
        import pymetis  # noqa: PLC0415
    except ImportError:
        return []
    adjacency = pymetis.CSRAdjacency(graph.first.astype(np.int32), graph.neighbour.astype(np.int32))
    # METIS uses random numbers: a fixed seed makes its parts a function of the graph.
    found = pymetis.part_graph(processes, adjacency, options=pymetis.Options(seed=0))
    home = _levelled(graph, np.array(found.vertex_part, dtype=np.int64), processes)
    nodes = home.argsort(kind="stable")
    parts = np.split(nodes, np.cumsum(np.bincount(home, minlength=processes))[:-1])
    return [tuple(sorted(parts, key=lambda part: int(part[0])))]


def _levelled(graph: Graph, home: Index, processes: int) -> Index:
    """Return the part of each node, (n,), moved so that no two parts differ by more than one node.

    METIS permits itself a few per cent. From a part that is too large, move the nodes with the least loss of edges
    inside the part.
    """
    home = home.copy()
    size = np.bincount(home, minlength=processes)
    least, more = divmod(graph.n, processes)
    # The largest parts get the remainder, one node each.
    room = np.full(processes, least)
    room[np.argsort(-size, kind="stable")[:more]] += 1
    for p in np.flatnonzero(size > room).tolist():
        inside = home[graph.neighbour] == home[graph.node]
        inner = np.bincount(graph.node, inside, graph.n)
        short = np.flatnonzero(size < room)
        # Prefer nodes with an edge to a part that has room, and few edges within their own.
        towards = np.bincount(graph.node, np.isin(home[graph.neighbour], short), graph.n)
        own = np.flatnonzero(home == p)
        moved = own[np.lexsort((own, (inner - towards)[own]))][: size[p] - room[p]]
        for node in moved.tolist():
            near = home[graph.neighbour[graph.first[node] : graph.first[node + 1]]]
            open_ = np.flatnonzero(size < room)
            beside = np.bincount(near, minlength=processes)[open_]
            q = int(open_[beside.argmax()])
            home[node] = q
            size[p] -= 1
            size[q] += 1
    return home


def pieces(graph: Graph) -> Index:
    """Return the first node of each connected piece of the graph, ascending."""
    # Not scipy: it takes a fifth of a second to load, and every `check` would pay that.
    first = np.arange(graph.n)
    while True:
        ends = np.sort(first[graph.edges], axis=1)
        low, high = ends[ends[:, 0] < ends[:, 1]].T
        if not len(low):
            return np.unique(first)
        np.minimum.at(first, high, low)
        while (first[first] < first).any():
            first = first[first]


def _beside(graph: Graph, roots: Index | None = None) -> Any:
    """Return the adjacency matrix; with `roots`, add a last node with edges to the roots."""
    import scipy.sparse  # noqa: PLC0415

    to, first = graph.neighbour, graph.first
    if roots is not None:
        to, first = np.append(to, roots), np.append(first, first[-1] + len(roots))
    n = len(first) - 1
    return scipy.sparse.csr_array((np.ones(len(to), np.int8), to, first), (n, n))


def _blocks(order: Index, processes: int) -> tuple[Index, ...]:
    return tuple(np.sort(block).astype(np.int64) for block in np.array_split(order, processes))


def cut(graph: Graph, parts: tuple[Index, ...]) -> int:
    """Return the number of edges between different parts. Weights do not matter: each message has the same cost."""
    return int(_crossing(graph, parts).sum())


def cut_weight(graph: Graph, parts: tuple[Index, ...]) -> float:
    """Return the sum of the weights of the edges between different parts."""
    crossing = _crossing(graph, parts)
    return float(crossing.sum() if graph.weights is None else graph.weights[crossing].sum())


def _crossing(graph: Graph, parts: tuple[Index, ...]) -> Mask:
    home = np.empty(graph.n, dtype=np.int64)
    home[np.concatenate(parts)] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return np.asarray(home[graph.edges[:, 0]] != home[graph.edges[:, 1]])
