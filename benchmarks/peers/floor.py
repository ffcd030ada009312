"""The floor: the law of all nodes at once as arrays in one process, without messages; it stores only the trajectory."""

from __future__ import annotations

import numpy as np

from benchmarks.peers.network import Done, Network, Plant
from hedgerow.agents.law import Minimax
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.network import padded


def run(network: Network, steps: int) -> Done:
    """Run in this process."""
    plant = Plant(network, steps)
    graph = Graph(len(network), np.array(network.edges, dtype=np.int64).reshape(-1, 2))
    law = Minimax(network.b, padded(network.candidates))
    going = True
    while going:
        x, u = plant.x, law.act(plant.x)
        going = plant.step(u)
        law.learn(x, graph.flow(u), plant.x)
    return plant.done()
