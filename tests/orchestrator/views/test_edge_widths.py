"""Edges of less weight are drawn thinner, and all alike where none has a weight."""

from __future__ import annotations

import numpy as np

from hedgerow.orchestrator.views.palette import thickness
from hedgerow.orchestrator.views.rerun.network_picture import Picture
from tests.tools.networks import observe, read, simulate

HEAD = (
    "name: n\nb: 0.1\nsteps: 4\ndefaults: {a: 0.5, candidates: [0.5], x0: 1}\nnodes: {1: {x0: 5}, 2: {}, 3: {x0: 5}}\n"
)


def test_the_widest_edge_has_the_largest_weight() -> None:
    assert thickness(np.array([4.0, 1.0, 1e-9]), 3).tolist() == [1.0, 0.5, 0.3]
    assert thickness(None, 2).tolist() == [1.0, 1.0]
    assert thickness(np.array([]), 0).tolist() == []


def test_the_picture_scales_flow_and_width_by_the_weight() -> None:
    """Both edges have the same difference of inputs; the one of a quarter of the weight carries a quarter."""
    topology = read(HEAD + "edges: [[1, 2], {ends: [2, 3], weight: 0.25}]\n")
    _, batch = observe(topology, simulate(topology))
    rows = np.array([0])
    widths = -Picture(topology).frames(batch, rows, np.zeros(4)).widths[0]
    by_edge = {edge: widths[topology.graph.edge == edge] for edge in (0, 1)}
    full, quarter = float(by_edge[0][0]), float(by_edge[1][0])
    assert (by_edge[0] == by_edge[0][0]).all()
    assert quarter / full == np.float32((0.4 + 0.25) * 0.5 / 1.4)
    plain = read(HEAD + "edges: [[1, 2], [2, 3]]\n")
    _, batch = observe(plain, simulate(plain))
    assert len(np.unique(Picture(plain).frames(batch, rows, np.zeros(4)).widths)) == 1
