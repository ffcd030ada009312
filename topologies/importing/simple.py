"""The conversion of a source's graph to an undirected one without loops and repeated edges; each change is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hedgerow.topologies.graph import LARGEST, Array, Index
from hedgerow.topologies.importing.found import Found, refuse
from hedgerow.topologies.importing.options import Options


def simple(found: Found, options: Options) -> Found:
    """Return the graph with every edge once, and the changes made.

    Raise UserError for a weight that is not above 0, and for a source without nodes.
    """
    if not len(found.names):
        raise refuse(found.source, "has no nodes", "Name a file that holds a network")
    _check_weights(found)
    changes = list(found.changes)
    edges, weights = found.edges, found.weights
    low, high = edges.min(axis=1, initial=2**62), edges.max(axis=1, initial=-1)
    if loops := int((low == high).sum()):
        changes.append(f"{_count(loops, 'loop')} dropped: an edge joins two nodes")
        left = low != high
        edges, low, high = edges[left], low[left], high[left]
        weights = None if weights is None else weights[left]
    edges, weights, parallel, both, unlike = _merged(
        len(found.names), edges, low, high, weights, found.directed or options.directed
    )
    if parallel:
        changes.append(f"{_count(parallel, 'parallel edge')} merged: their weights are added")
    if both:
        differ = f"; {_count(unlike, 'edge')} of them had two unequal weights" if unlike else ""
        changes.append(f"{_count(both, 'edge')} in both directions: each is one edge, of the mean weight{differ}")
    if options.max_degree is not None:
        edges, weights, dropped = _of_degree(len(found.names), edges, weights, options.max_degree)
        if dropped:
            changes.append(
                f"{_count(dropped, 'edge')} dropped: a node keeps the {options.max_degree} of the largest weights"
            )
    found = replace(found, edges=edges, weights=weights, edge_names=None, directed=False, changes=changes)
    return _component(found, options.largest_component)


def _check_weights(found: Found) -> None:
    weights = found.weights
    if weights is None or not len(weights):
        return
    good = (weights > 1 / LARGEST) & (weights < LARGEST)
    if not good.all():
        bad = np.flatnonzero(~good)
        k = int(bad[0])
        what = found.sign(float(weights[k]))
        more = f", and {len(bad) - 1} more like it" if len(bad) > 1 else ""
        raise refuse(
            found.place(k),
            f"the weight {weights[k]:g} is not above 0{f', {what}' if what else ''}{more}",
            "Remove the edge, or choose weights with --weight",
        )


def _merged(
    n: int, edges: Index, low: Index, high: Index, weights: Array | None, directed: bool
) -> tuple[Index, Array | None, int, int, int]:
    """Return each edge once in the order of its first mention, its weight, and the number of merged edges by either
    rule; last, how many had another weight in each direction.
    """
    if not len(edges):
        return edges, weights, 0, 0, 0
    key, first, inverse, count = np.unique(low * n + high, return_index=True, return_inverse=True, return_counts=True)
    if len(key) == len(edges):
        return edges, weights, 0, 0, 0
    total = np.bincount(inverse, np.ones(len(edges)) if weights is None else weights, len(key))
    ways = np.ones(len(key), dtype=np.int64)
    unlike = 0
    if directed:
        is_forward, given = edges[:, 0] == low, np.ones(len(edges)) if weights is None else weights
        forward, backward = (np.bincount(inverse, given * way, len(key)) for way in (is_forward, ~is_forward))
        ways += (forward > 0) & (backward > 0)
        unlike = int(((ways == 2) & (forward != backward)).sum())
    mean: Array = total / ways
    order = first.argsort()
    both = int((ways == 2).sum())
    parallel = int((count - ways).sum())
    merged = None if weights is None and (mean == 1).all() else mean[order]
    return edges[first[order]], merged, parallel, both, unlike


def _of_degree(n: int, edges: Index, weights: Array | None, most: int) -> tuple[Index, Array | None, int]:
    """Return the edges that are among the `most` of largest weight at both ends, and the number of the others."""
    ranked = np.arange(len(edges)) if weights is None else (-weights).argsort(kind="stable")
    ends = edges[ranked].ravel()
    order = ends.argsort(kind="stable")
    first = np.searchsorted(ends[order], np.arange(n))
    rank = np.empty_like(ends)
    rank[order] = np.arange(len(ends)) - first[ends[order]]
    left = np.sort(ranked[(rank < most).reshape(-1, 2).all(axis=1)])
    return edges[left], None if weights is None else weights[left], len(edges) - len(left)


def _component(found: Found, largest: bool) -> Found:
    """Return the network, or its largest connected piece, and report the number of pieces."""
    from scipy.sparse import coo_array  # noqa: PLC0415 (half a second to load)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    n, edges = len(found.names), found.edges
    matrix = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    count, piece = connected_components(matrix, directed=False)
    if count == 1:
        return found
    sizes = np.bincount(piece)
    if not largest:
        found.changes.append(
            f"The network falls into {count} pieces, the largest of {_count(int(sizes.max()), 'node')}; "
            "--largest-component keeps that one"
        )
        return found
    inside = piece == sizes.argmax()
    found.changes.append(
        f"{_count(count - 1, 'smaller piece')} with {_count(int((~inside).sum()), 'node')} dropped: "
        "the largest component is kept"
    )
    return only(found, np.flatnonzero(inside))


def only(found: Found, nodes: Index) -> Found:
    """Return the subnetwork of some nodes, given by ascending positions, with the edges between them."""
    place = np.full(len(found.names), -1)
    place[nodes] = np.arange(len(nodes))
    left = (place[found.edges] >= 0).all(axis=1)

    def some(array: Array | None) -> Array | None:
        return None if array is None else array[nodes]

    return replace(
        found,
        names=[found.names[k] for k in nodes],
        edges=place[found.edges[left]],
        labels=None if found.labels is None else [found.labels[k] for k in nodes],
        positions=some(found.positions),
        storage=some(found.storage),
        samples=some(found.samples),
        weights=None if found.weights is None else found.weights[left],
        edge_names=None if found.edge_names is None else [found.edge_names[k] for k in np.flatnonzero(left).tolist()],
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
