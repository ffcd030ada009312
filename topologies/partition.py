"""Which process has which nodes: parts of one size, between which few edges cross."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from topologies.graph import Graph, Index

IN_ORDER = 64
"""Networks of up to so many nodes, which people write, are cut in the order of the file."""


@lru_cache(maxsize=8)
def partition(graph: Graph, processes: int) -> tuple[Index, ...]:
    """Positions of nodes by process, ascending; a function of the graph alone.

    Blocks of the file's own order, or of the reverse Cuthill-McKee order if fewer edges cross those.
    """
    in_order = _blocks(np.arange(graph.n), processes)
    if graph.n <= IN_ORDER or processes in (1, graph.n) or not (crossing := cut(graph, in_order)):
        return in_order
    import scipy.sparse  # noqa: PLC0415 (half a second, and only large networks need it)
    from scipy.sparse.csgraph import reverse_cuthill_mckee  # noqa: PLC0415

    stops = np.concatenate([[0], graph.degree.cumsum()])
    beside = scipy.sparse.csr_array((np.ones(len(graph.node), np.int8), graph.neighbour, stops), (graph.n, graph.n))
    banded = _blocks(reverse_cuthill_mckee(beside, symmetric_mode=True), processes)
    return banded if cut(graph, banded) < crossing else in_order


def _blocks(order: Index, processes: int) -> tuple[Index, ...]:
    return tuple(np.sort(block).astype(np.int64) for block in np.array_split(order, processes))


def cut(graph: Graph, parts: tuple[Index, ...]) -> int:
    """How many edges cross from one part to another."""
    home = np.empty(graph.n, dtype=np.int64)
    home[np.concatenate(parts)] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return int((home[graph.edges[:, 0]] != home[graph.edges[:, 1]]).sum())
