"""A jump in a network that is large enough for compiled loops."""

from __future__ import annotations

import numpy as np

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.fast import LARGE
from tests.tools.networks import observe, read, simulate

FAULTS = "[{kind: jump, node: 3, at: 2, a: 0.3}, {kind: jump, node: 5, at: 5, a: 0.2}]"


def test_a_jump_in_a_large_network_is_observed() -> None:
    graph = f"{{kind: ring, nodes: {LARGE}}}"
    defaults = "{candidates: [0.2, 0.3], x0: 1}"
    topology = read(
        f"{{name: large, b: 0.01, steps: 8, seed: 1, graph: {graph}, defaults: {defaults}, faults: {FAULTS}}}"
    )
    observer, batch = observe(topology, simulate(topology, layout(topology, 1)))
    assert observer.checks["dynamics"].excess <= 0
    np.testing.assert_array_equal(batch.a[5:, [3, 5]], [[0.3, 0.2]] * 3)
