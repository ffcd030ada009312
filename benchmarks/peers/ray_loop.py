"""Ray: one actor per process, one compiled graph with one execution per step; the driver is the plant.

An actor acts on its x. It reads the messages of its neighbours straight from their processes, through shared memory. It
answers the plant after that, so the graph has one leaf per actor.
"""

from __future__ import annotations

import logging
import os
import tempfile

import ray
from ray.dag import InputNode, MultiOutputNode

from benchmarks.peers.network import Agent, Done, Network, Plant

STORE_BYTES = 200 * 2**20


class Actor:
    """One agent."""

    def __init__(self, network: Network, me: int) -> None:
        self._agent, self._me = Agent(network, me), me
        self._heard: tuple[float, ...] = ()

    def ready(self) -> int:
        """Report that the actor has started."""
        return self._me

    def act(self, x: float) -> tuple[float, float]:
        """Return (x, u) of this step."""
        return x, self._agent.step(x, self._heard)

    def hear(self, own: tuple[float, float], *sent: tuple[float, float]) -> float:
        """Store the neighbours' messages for the next step; return its own u for the plant."""
        self._heard = tuple(u for _, u in sent)
        return own[1]


def run(network: Network, steps: int) -> Done:
    """Run with the plant in this process."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    plant, n = Plant(network, steps), len(network)
    with tempfile.TemporaryDirectory(prefix="ray-") as folder:
        ray.init(
            include_dashboard=False,
            object_store_memory=STORE_BYTES,
            logging_level=logging.ERROR,
            log_to_driver=False,
            _temp_dir=folder,
        )
        remote = ray.remote(num_cpus=0)(Actor)
        actors = [remote.remote(network, i) for i in range(n)]
        ray.get([actor.ready.remote() for actor in actors])
        with InputNode() as states:
            sent = [actor.act.bind(states[i]) for i, actor in enumerate(actors)]
            heard = [
                actor.hear.bind(sent[i], *(sent[j] for j in network.neighbours(i))) for i, actor in enumerate(actors)
            ]
            graph = MultiOutputNode(heard)
        compiled = graph.experimental_compile()
        going = True
        while going:
            going = plant.step(ray.get(compiled.execute(*plant.x.tolist())))
        done = plant.done()
        compiled.teardown()
        ray.shutdown()
        return done
