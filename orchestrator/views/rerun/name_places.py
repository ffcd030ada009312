"""The places of the names in the picture of a network: beside their nodes, off edges, nodes and other names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hedgerow.orchestrator.views.clearance import Ends, Places

BOX_PX = 24.0
"""the height of a name's box in Rerun [px]"""
LETTER_PX, EDGES_PX = 7.5, 14.0
"""the width of a letter of a name, and of the box without letters [px]"""
DROP_PX = 13.5
"""Rerun centres the box of a name this far below its point [px]"""
GAP_PX = 2.0
EDGE_PX = 4.0
"""half the width of a thick edge [px]"""
DIRECTIONS = 16
SAMPLES = 25
"""the points of an edge that are compared with a box"""


def name_places(places: Places, edges: Ends, radius: float, names: Sequence[str], px: float) -> tuple[Places, Places]:
    """Return the point of each name, (n, 2), and the half width and half height of its box, (n, 2).

    `px` is the length of a pixel in the unit of the places. Each name in turn takes the direction with the smallest
    overlap of its box with nodes, edges and earlier names; without any overlap, this is the right of its node.
    """
    n = len(places)
    half = np.array([[LETTER_PX * len(name) + EDGES_PX, BOX_PX] for name in names]).reshape(n, 2) * px / 2
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # Prefer the right, and then the sides nearest to it: most names are then on one side.
    preference = 1e-3 * (1 - way[:, 0])
    part = np.linspace(0, 1, SAMPLES)[:, None]
    start, stop = places[edges[:, 0]], places[edges[:, 1]]
    points = (start[:, None] + part * (stop - start)[:, None]).reshape(-1, 2)
    low, high = places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)
    centres = np.zeros((n, 2))
    for k in range(n):
        # The nearest centre in each direction at which the box does not touch the ring.
        ring = 1.45 * radius + GAP_PX * px
        centre = places[k] + way * (ring + _extent(way, half[k]))[:, None]
        others = np.delete(places, k, axis=0)
        cost = preference + 2 * _within(points, centre, half[k] + EDGE_PX * px).sum(axis=1) / SAMPLES
        cost = cost + 3 * _within(others, centre, half[k] + ring).sum(axis=1)
        cost = cost + 3 * _overlaps(centres[:k], half[:k], centre, half[k])
        cost = cost + np.maximum(0, np.abs(centre - (low + high) / 2) - (high - low) / 2 - 2.5 * radius).sum(axis=1)
        centres[k] = centre[np.argmin(cost)]
    return centres - np.array([0.0, DROP_PX * px]), half


def _extent(way: Places, half: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of the centre of a box from its border in each direction."""
    return np.asarray(np.min(half / np.maximum(np.abs(way), 1e-9), axis=1))


def _within(points: Places, centre: Places, half: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are in the box around each centre, (D, P)."""
    return np.asarray((np.abs(points - centre[:, None]) < half).all(axis=2))


def _overlaps(boxes: Places, sizes: Places, centre: Places, half: NDArray[np.float64]) -> NDArray[np.int_]:
    """Return the number of boxes that overlap the box around each centre, (D,)."""
    return np.asarray((np.abs(boxes - centre[:, None]) < sizes + half).all(axis=2).sum(axis=1))
