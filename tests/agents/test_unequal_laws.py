"""Every listed law in networks of unequal gains and weights: the same bits in every layout, and as in equal ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hedgerow.agents.laws import LAWS
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.topologies.graph import Graph
from tests.tools.networks import read, simulate

NETWORK = """
name: unequal
b: 0.1
steps: 40
seed: 3
defaults: {x0: 5, b: {random: [0.03, 0.12]}, disturbance: {kind: white, std: 0.3}}
nodes: [1, 2, 3, 4, 5]
edges:
  - [1, 2]
  - {ends: [2, 3], weight: 0.25}
  - {ends: [3, 4], weight: {random: [0.5, 2]}}
  - {ends: [2, 5], weight: 2}
faults:
  - {kind: drop, link: [2, 3], steps: [5, 20]}
  - {kind: cut, edge: [3, 4], steps: [10, 15]}
  - {kind: crash, node: 2, at: 22, restart_after: 4}
"""


@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_layout_gives_the_same_bits(law: str) -> None:
    topology = completed(read(NETWORK, f"law={law}"))
    one = simulate(topology, layout(topology, 1))
    assert np.isfinite(one.x).all()
    assert simulate(topology, layout(topology, None)).same_bits(one)
    assert simulate(topology, layout(topology, 2)).same_bits(one)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_numbers_that_are_alike_give_the_bits_of_one_number(law: str) -> None:
    topology = completed(read(NETWORK, f"law={law}", "defaults.b=0.05"))
    network, n, edges = topology.network, 5, topology.graph.edges
    one = replace(network, b=0.05, graph=Graph(n, edges))
    spelled = replace(network, b=np.full(n, 0.05), graph=Graph(n, edges, np.ones(len(edges))))
    assert simulate(topology.of_network(spelled)).same_bits(simulate(topology.of_network(one)))
