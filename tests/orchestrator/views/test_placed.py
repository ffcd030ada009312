"""Pictures use the positions and labels of the file."""

from __future__ import annotations

import numpy as np

import hedgerow as hg
from hedgerow.orchestrator.views.layout import placed, positions

SQUARE = {
    "name": "square",
    "b": 0.1,
    "steps": 5,
    "nodes": {
        "p": {"position": [0, 0], "label": "Pé"},
        "q": {"position": [2, 0]},
        "r": {"position": [2, 2]},
        "s": {"position": [0, 2]},
    },
    "edges": [["p", "q"], ["q", "r"], ["r", "s"], ["s", "p"]],
}


def test_nodes_stand_at_their_positions_with_y_upwards() -> None:
    places = placed(hg.load(SQUARE))
    np.testing.assert_allclose(places, [[0, 1], [1, 1], [1, 0], [0, 0]])


def test_a_node_without_a_position_is_between_its_neighbours() -> None:
    net = hg.Network.of(SQUARE).with_node("t").with_edge("t", "p").with_edge("t", "r")
    places = placed(net.topology)
    assert np.hypot(*(places[4] - places[:4].mean(axis=0))) < 0.2


def test_a_network_without_positions_is_laid_out() -> None:
    topology = hg.load("paper7")
    np.testing.assert_array_equal(placed(topology), positions(topology.graph))


def test_labels_name_nodes() -> None:
    net = hg.Network.of(SQUARE)
    assert (net.topology.network.name(0), net.topology.network.title(0)) == ("Pé", "p Pé")
    assert (net.topology.network.name(1), net.topology.network.title(1)) == ("q", "q")
    assert "Pé" in net.check()
    assert net.graph.nodes["p"]["label"] == "Pé"
