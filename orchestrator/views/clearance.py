"""The space between a node of a drawn network and the edges of other nodes.

A node that lies on an edge looks like an end of that edge. The layout by stress does not prevent this, so its places
are corrected here: nodes and edges that are too near push each other apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.float64]
Ends = NDArray[np.integer]

CLEAR = 0.45
"""the wanted distance of a node from the edges of other nodes [mean edge lengths]"""
APART = 0.7
"""the wanted distance of two nodes [mean edge lengths]"""
NODES = 60
"""the maximum number of nodes: the work grows with nodes times edges, and larger pictures have smaller nodes"""
ROUNDS = 300


def cleared(places: Places, edges: Ends) -> Places:
    """Return the places, (n, 2), with nodes moved off the edges, (E, 2), of other nodes.

    Places without a node that is too near are returned unchanged. A dense network has no room for all: then the places
    are those of the round with the smallest sum of squared shortfalls.
    """
    n = len(places)
    if n < 3 or n > NODES or not len(edges):
        return places
    length = max(float(np.hypot(*(places[edges[:, 0]] - places[edges[:, 1]]).T).mean()), 1e-9)
    best, now, least = places, places / length, np.inf
    for _ in range(ROUNDS):
        push, short = _push(now, edges)
        if short < least:
            best, least = now * length, short
        if short < 1e-6:
            break
        now = now + push
    return best


def distances(places: Places, edges: Ends) -> NDArray[np.float64]:
    """Return the distance of every node from every edge of other nodes, (n, E); infinite for the ends of an edge."""
    return np.asarray(np.hypot(*np.moveaxis(_offsets(places, edges)[0], -1, 0)))


def _offsets(places: Places, edges: Ends) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the vector from the nearest point of each edge to each node, (n, E, 2), and that point's part of the
    edge, (n, E).
    """
    start, way = places[edges[:, 0]], places[edges[:, 1]] - places[edges[:, 0]]
    to = places[:, None] - start
    part = np.clip((to * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-12), 0, 1)
    offset = to - part[:, :, None] * way
    column = np.arange(len(edges))
    offset[edges[:, 0], column] = offset[edges[:, 1], column] = np.inf
    return offset, part


def _push(places: Places, edges: Ends) -> tuple[Places, float]:
    """Return the movement of every node, (n, 2), and the sum of squared shortfalls."""
    offset, part = _offsets(places, edges)
    step, short = np.zeros_like(places), 0.0
    distance = np.hypot(offset[:, :, 0], offset[:, :, 1])
    node, edge = np.nonzero(distance < CLEAR)
    if len(node):
        lack = CLEAR - distance[node, edge]
        short += float((lack**2).sum())
        way = places[edges[edge, 1]] - places[edges[edge, 0]]
        # A node exactly on an edge has no side: push it across the edge.
        across = np.stack([-way[:, 1], way[:, 0]], axis=1)
        towards = np.where((distance[node, edge] > 1e-9)[:, None], offset[node, edge], across)
        towards = 0.2 * lack[:, None] * towards / np.maximum(np.hypot(*towards.T), 1e-12)[:, None]
        np.add.at(step, node, towards)
        np.add.at(step, edges[edge, 0], -towards * (1 - part[node, edge])[:, None])
        np.add.at(step, edges[edge, 1], -towards * part[node, edge][:, None])
    between = places[:, None] - places
    gap = np.hypot(between[:, :, 0], between[:, :, 1])
    np.fill_diagonal(gap, np.inf)
    one, other = np.nonzero(gap < APART)
    if len(one):
        lack = APART - gap[one, other]
        short += float((lack**2).sum())
        np.add.at(step, one, 0.2 * lack[:, None] * between[one, other] / np.maximum(gap[one, other], 1e-9)[:, None])
    return step, short
