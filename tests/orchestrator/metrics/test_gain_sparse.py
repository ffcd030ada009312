"""The bound of sparse networks with one cycle, for which a way of the solver to merge blocks panics or never ends."""

from __future__ import annotations

import networkx as nx
import pytest

import hedgerow as hg


@pytest.mark.parametrize("seed", [0, 2])
def test_the_run_of_a_network_with_one_cycle_ends(seed: int) -> None:
    graph = nx.connected_watts_strogatz_graph(26 - seed // 2, 3, 0.5, seed=seed)
    net = hg.from_networkx(graph, steps=3)
    run = hg.simulate(net)
    assert run.T == 3
