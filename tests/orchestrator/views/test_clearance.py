"""No node of a drawn network lies on an edge of other nodes, and no name lies on a node."""

from __future__ import annotations

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.orchestrator.views.clearance import CLEAR, cleared, distances
from hedgerow.orchestrator.views.layout import positions
from hedgerow.orchestrator.views.rerun.name_places import DROP_PX, name_places
from hedgerow.orchestrator.views.rerun.network_picture import Picture
from hedgerow.topologies.schema import Topology

KINDS = [
    {"kind": "small_world", "rewire": 0.2},
    {"kind": "geometric", "mean_degree": 4},
    {"kind": "scale_free", "attach": 2},
]
RING = 1.45
"""the radius of a node's ring in the viewer, in radii of the node"""


def drawn(kind: dict[str, object], nodes: int, seed: int) -> Topology:
    return hg.load(
        {
            "name": "drawn",
            "b": 0.05,
            "steps": 5,
            "seed": seed,
            "defaults": {"a": 0.3, "candidates": [0.3, 0.5]},
            "graph": {**kind, "nodes": nodes},
        }
    )


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind["kind"])
@pytest.mark.parametrize("nodes", [7, 12, 30])
def test_no_node_lies_on_an_edge_of_other_nodes(kind: dict[str, object], nodes: int) -> None:
    for seed in range(5):
        picture = Picture(drawn(kind, nodes, seed))
        gaps = distances(picture.places, picture._graph.edges)
        assert gaps.min() > RING * picture._radius


def test_a_node_on_an_edge_moves_off_it() -> None:
    places, edges = np.array([[0.0, 0], [2, 0], [1, 0], [1, 1]]), np.array([[0, 1], [2, 3]])
    moved = cleared(places, edges)
    assert distances(moved, edges).min() > 0.9 * CLEAR


@pytest.mark.parametrize("name", ["grid16", "ring6"])
def test_a_layout_with_enough_space_keeps_its_places(name: str) -> None:
    graph = hg.load(name).graph
    places = positions(graph)
    np.testing.assert_array_equal(cleared(places, graph.edges), places)


def test_the_same_network_has_the_same_places() -> None:
    one, other = (positions(drawn(KINDS[0], 12, 3).graph) for _ in range(2))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind["kind"])
def test_no_name_lies_on_a_node_or_on_another_name(kind: dict[str, object]) -> None:
    picture = Picture(drawn(kind, 12, 3))
    px, names = picture.legend.pixel, [str(k) for k in range(12)]
    points, half = name_places(picture.places, picture._graph.edges, picture._radius, names, px)
    centres = points + np.array([0.0, DROP_PX * px])
    apart = np.abs(centres[:, None] - picture.places)
    on_node = (apart < half[:, None] + 0.7 * picture._radius).all(axis=2)
    on_name = (np.abs(centres[:, None] - centres) < half[:, None] + half).all(axis=2)
    np.fill_diagonal(on_name, val=False)
    assert not on_node.any()
    assert not on_name.any()


def test_a_name_without_obstacles_is_at_the_right_of_its_node() -> None:
    places = np.array([[0.0, 0], [0, 1]])
    points, _ = name_places(places, np.array([[0, 1]]), 0.1, ["a", "b"], 0.01)
    assert (points[:, 0] > places[:, 0] + 0.1).all()
