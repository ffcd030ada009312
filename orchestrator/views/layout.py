"""The places of the nodes in the picture of a network: the same places for the same file.

    a tree     its levels below each other, the first node of the file on top; a bushy one in rings around its centre
    others     stress majorisation: distances on paper as near as can be to those in the graph; then nodes are moved off
               the edges of other nodes

Distances are in mean edge lengths; y points down.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, shortest_path

from hedgerow.orchestrator.views.clearance import cleared
from hedgerow.topologies.graph import Graph, Index
from hedgerow.topologies.schema import Topology

Places = NDArray[np.float64]

PIVOTS = 60
STRESS_NODES = 1500
"""components with more nodes are placed by the distances to PIVOTS of their nodes, because stress needs the square
of n
"""
WIDE = 1.5
"""the ratio of width to height of the picture"""
APART = 1.0
"""the space between components"""
_GOLDEN = np.pi * (3 - 5**0.5)


def placed(topology: Topology) -> Places:
    """Return the place of each node of a resolved topology, (n, 2): those in the file, where y points up, or a layout.

    A node without a position is placed between its neighbours, if they have one.
    """
    network = topology.network
    graph, given = network.graph, network.positions
    if given is None or not len(graph.edges):
        return positions(graph)
    known = ~np.isnan(given[:, 0])
    places = np.where(known[:, None], given, given[known].mean(axis=0)) * np.array([1.0, -1.0])
    if not known.all():
        # Move a leaf a little away from its neighbour: otherwise it would be hidden.
        count = np.maximum(graph.degree, 1)[:, None]
        for _ in range(200):
            sums = np.stack([np.bincount(graph.node, axis[graph.neighbour], graph.n) for axis in places.T], axis=1)
            places = np.where(known[:, None], places, sums / count)
        k = np.arange(graph.n)
        apart = 0.05 * _mean_length(places, graph) * np.stack([np.cos(_GOLDEN * k), np.sin(_GOLDEN * k)], axis=1)
        places = np.where(known[:, None], places, places + apart)
    return np.asarray((places - places.min(axis=0)) / _mean_length(places, graph))


def _mean_length(places: Places, graph: Graph) -> float:
    step = places[graph.edges[:, 0]] - places[graph.edges[:, 1]]
    return max(float(np.hypot(*step.T).mean()), 1e-9)


def positions(graph: Graph) -> Places:
    """Return the place of each node, (n, 2)."""
    ones = np.ones(len(graph.node))
    matrix = csr_matrix((ones, (graph.node, graph.neighbour)), shape=(graph.n, graph.n))
    count, which = connected_components(matrix, directed=False)
    order = np.argsort(which, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(which, minlength=count))[:-1])
    placed = [_component(matrix[part][:, part].tocsr()) for part in parts]
    found = np.zeros((graph.n, 2))
    for part, corner, own in zip(parts, _shelves(placed), placed, strict=True):
        found[part] = own + corner
    return found


def _component(matrix: csr_matrix) -> Places:
    """Return the places of a connected component, with its corner at 0."""
    n, edges = matrix.shape[0], matrix.nnz // 2
    if n == 1:
        return np.zeros((1, 2))
    neighbours = [matrix.indices[matrix.indptr[k] : matrix.indptr[k + 1]] for k in range(n)]
    if edges == n - 1:
        places = _tree(neighbours)
    else:
        node, neighbour = matrix.nonzero()
        ends = np.stack([node, neighbour], axis=1)[node < neighbour]
        places = _upright(cleared(_stress(matrix), ends), matrix)
    return np.asarray(places - places.min(axis=0))


def _tree(neighbours: list[Index]) -> Places:
    """Return one column per leaf and one row per level; use rings if there are many more leaves than levels."""
    ends = [k for k, own in enumerate(neighbours) if len(own) == 1]
    path = len(ends) == 2
    across, level, leaves = _tidy(neighbours, ends[0] if path else 0)
    if path:
        return np.stack([level, across], axis=1)
    if leaves <= 3 * level.max() and leaves <= 24:
        width, height = leaves - 1, level.max()
        return np.stack([across * max(1.0, WIDE * height / max(width, 1)), level], axis=1)
    across, level, leaves = _tidy(neighbours, _centre(neighbours))
    angle = 2 * np.pi * across / leaves
    # Give the rings the distance of their nodes: a ring of a thousand nodes must not squeeze the inner ones.
    radius = level * max(1.0, leaves / (2 * np.pi * level.max() * 3))
    return np.stack([radius * np.sin(angle), -radius * np.cos(angle)], axis=1)


def _walk(neighbours: list[Index], root: int) -> tuple[list[int], Index]:
    """Return the nodes in the order of their distance from the root, and the predecessor of each; -1 for the root."""
    parent = np.full(len(neighbours), -2)
    parent[root] = -1
    order, waiting = [], deque([root])
    while waiting:
        node = waiting.popleft()
        order.append(node)
        for one in neighbours[node].tolist():
            if parent[one] == -2:
                parent[one] = node
                waiting.append(one)
    return order, parent


def _tidy(neighbours: list[Index], root: int) -> tuple[Places, Places, int]:
    """Return the column and the level of each node, and the number of leaves."""
    order, parent = _walk(neighbours, root)
    level = np.zeros(len(order))
    children: list[list[int]] = [[] for _ in order]
    for node in order[1:]:
        level[node] = level[parent[node]] + 1
        children[parent[node]].append(node)
    across, leaves, stack = np.zeros(len(order)), 0, [root]
    while stack:  # leaves from left to right
        node = stack.pop()
        if not children[node]:
            across[node] = leaves
            leaves += 1
        stack += reversed(children[node])
    for node in reversed(order):
        if own := children[node]:
            across[node] = (across[own[0]] + across[own[-1]]) / 2
    return across, level, leaves


def _centre(neighbours: list[Index]) -> int:
    """Return the node in the middle of the longest path."""
    last = _walk(neighbours, 0)[0][-1]
    order, parent = _walk(neighbours, last)
    path = [order[-1]]
    while parent[path[-1]] >= 0:
        path.append(int(parent[path[-1]]))
    return path[len(path) // 2]


def _stress(matrix: csr_matrix) -> Places:
    """Return the layout of Gansner, Koren and North (2004), started from the distances to some pivots."""
    n = matrix.shape[0]
    places = _by_pivots(matrix)
    if n > STRESS_NODES:
        return places
    distance = np.asarray(shortest_path(matrix, unweighted=True), dtype=np.float32)
    np.fill_diagonal(distance, 1)
    weight = distance**-2
    np.fill_diagonal(weight, 0)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    inverse = np.linalg.inv(laplacian.astype(np.float64) + 1 / n) - 1 / n
    pull = weight * distance
    for _ in range(200 if n <= 150 else 15):
        x, y = places.astype(np.float32).T
        ratio = pull / np.maximum(np.hypot(x[:, None] - x, y[:, None] - y), 1e-4)
        places = inverse @ (ratio.sum(axis=1)[:, None] * places - ratio @ places)
    return places


def _by_pivots(matrix: csr_matrix) -> Places:
    """Return the layout of Brandes and Pich (2006): the two main directions of the squared distances to distant
    pivots.
    """
    n = matrix.shape[0]
    nearest = np.full(n, np.inf)
    columns: list[Places] = []
    for _ in range(min(n, PIVOTS)):
        pivot = int(np.argmax(nearest)) if columns else 0
        columns.append(shortest_path(matrix, unweighted=True, indices=pivot))
        nearest = np.minimum(nearest, columns[-1])
    squares = np.stack(columns, axis=1) ** 2
    centred = squares - squares.mean(axis=0) - squares.mean(axis=1)[:, None] + squares.mean()
    _, directions = np.linalg.eigh(centred.T @ centred)
    places = centred @ directions[:, :-3:-1]
    places *= np.sqrt(n) / max(float(np.ptp(places)), 1e-9)
    # Separate nodes with equal distances a little: they would stay in the same place.
    k = np.arange(n)
    return np.asarray(places + 0.1 * np.stack([np.cos(_GOLDEN * k), np.sin(_GOLDEN * k)], axis=1))


def _upright(places: Places, matrix: csr_matrix) -> Places:
    """Return the places turned: edges along the axes if possible, the wider side across, the first nodes at the top
    left.
    """
    ends = matrix.nonzero()
    step = places[ends[0]] - places[ends[1]]
    turn = np.angle(np.exp(4j * np.arctan2(step[:, 1], step[:, 0])).sum()) / 4
    turned = places @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    width, height = np.ptp(turned, axis=0)
    along = np.abs(turned[1] - turned[0])
    if height > 1.1 * width or (height > 0.9 * width and along[1] > along[0]):
        turned = turned[:, ::-1]
    middle = (turned.max(axis=0) + turned.min(axis=0)) / 2
    turned = (turned - middle) * np.where(turned[0] > middle, -1, 1)
    return np.asarray(turned / max(float(np.hypot(*step.T).mean()), 1e-9))


def _shelves(placed: list[Places]) -> list[Places]:
    """Return the corner of each component: the large ones first, from left to right, in rows."""
    size = [np.ptp(own, axis=0) + APART for own in placed]
    widest = max((WIDE * sum(float(w * h) for w, h in size)) ** 0.5, *(float(w) for w, _ in size))
    corners = [np.zeros(2)] * len(placed)
    x = y = row = 0.0
    for k in sorted(range(len(placed)), key=lambda k: (-size[k].prod(), k)):
        width, height = (float(length) for length in size[k])
        if x > 0 and x + width > widest + 1e-9:
            x, y, row = 0.0, y + row, 0.0
        corners[k] = np.array([x, y])
        x, row = x + width, max(row, height)
    return corners
