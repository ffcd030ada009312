"""mosaik: one simulator per process, values through its scheduler, which also contains the plant.

At time t the plant reads u(t - 1) and gives x(t). An agent reads x(t) and the values of its neighbours at t - 1, and
gives (x, u). All are time-based simulators with a step of 1; values of the step before travel over time-shifted
connections. Messages are JSON over TCP, which preserves every bit of a float.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import mosaik_api_v3

from benchmarks.peers.network import Agent, Done, Network, Plant

NETWORK = "HEDGEROW_BENCHMARK_NETWORK"
"""the variable with the file of the network"""


def _meta(model: str, parameters: list[str], attributes: list[str]) -> dict[str, Any]:
    models = {model: {"public": True, "params": parameters, "attrs": attributes}}
    return {"api_version": "3.0", "type": "time-based", "models": models}


class AgentSimulator(mosaik_api_v3.Simulator):
    """The simulator of one agent."""

    def __init__(self) -> None:
        super().__init__(_meta("Agent", ["me"], ["x", "heard", "sent"]))

    def create(self, num: int, model: str, me: int) -> list[dict[str, Any]]:
        """Create the one entity of the process."""
        assert num == 1
        self._agent = Agent(Network.read(os.environ[NETWORK]), me)
        return [{"eid": str(me), "type": model}]

    def step(self, time: int, inputs: dict[str, Any], max_advance: int) -> int:  # noqa: ARG002  (mosaik asks for the name)
        """Make one step of the agent."""
        ((self._me, own),) = inputs.items()
        (x,) = own["x"].values()
        heard = {int(sender.split(".")[1]): sent for sender, sent in own["heard"].items()} if time else {}
        self._sent = x, self._agent.step(x, [heard[j][1] for j in self._agent.neighbours] if time else [])
        return time + 1

    def get_data(self, _: dict[str, list[str]]) -> dict[str, Any]:
        """Return the message to plant and neighbours."""
        return {self._me: {"sent": self._sent}}


class PlantSimulator(mosaik_api_v3.Simulator):
    """The plant, with an entity for every node."""

    def __init__(self) -> None:
        super().__init__(_meta("Node", ["plant", "left"], ["x", "sent"]))

    def create(self, num: int, model: str, plant: Plant, left: list[Done]) -> list[dict[str, Any]]:
        """Create all nodes; `left` receives the result of the run."""
        self._plant, self._left, self._names = plant, left, [str(i) for i in range(num)]
        return [{"eid": name, "type": model} for name in self._names]

    def step(self, time: int, inputs: dict[str, Any], max_advance: int) -> int:  # noqa: ARG002  (mosaik asks for the name)
        """Make one step of all nodes; at the first, there are no inputs yet."""
        if time:
            sent = [next(iter(inputs[name]["sent"].values())) for name in self._names]
            if not self._plant.step([u for _, u in sent]):
                self._left.append(self._plant.done())
        self._x = dict(zip(self._names, self._plant.x.tolist(), strict=True))
        return time + 1

    def get_data(self, outputs: dict[str, list[str]]) -> dict[str, Any]:
        """Return the states of the requested nodes."""
        return {name: {"x": self._x[name]} for name in outputs}


def run(network: Network, steps: int) -> Done:
    """Run with the scheduler and the plant in this process."""
    import mosaik  # noqa: PLC0415  (an agent is 14 MB smaller without it)

    os.environ[NETWORK] = network.saved
    config = {
        "Plant": {"python": f"{__name__}:PlantSimulator"},
        "Agent": {"cmd": f"{sys.executable} -m {__name__} %(addr)s"},
    }
    world = mosaik.World(config, cache=False, skip_greetings=True)
    plant_simulator = world.start("Plant", sim_id="plant")
    left: list[Done] = []
    nodes = plant_simulator.Node.create(len(network), plant=Plant(network, steps), left=left)
    agents = [world.start("Agent", sim_id=f"agent{i}").Agent(me=i) for i in range(len(network))]
    for i, (node, agent) in enumerate(zip(nodes, agents, strict=True)):
        world.connect(node, agent, "x")
        world.connect(agent, node, "sent", time_shifted=True, initial_data={"sent": None})
        for j in network.neighbours(i):
            world.connect(agent, agents[j], ("sent", "heard"), time_shifted=True, initial_data={"sent": None})
    world.run(until=steps + 1, print_progress=False)
    return left[0]


if __name__ == "__main__":
    mosaik_api_v3.start_simulation(AgentSimulator())
