"""`python -m benchmarks.plan`: what a step costs past this machine, by a model of figures that are measured here.

Measured: the seconds of CPU a node that the plant and the agents spend on a step, in one process at `--nodes` nodes;
how many nodes of a graph of that size, cut into `--machines` parts by our partition, have a neighbour in another part,
and how many pairs of parts are neighbours. Known: the bytes of every message (wire.codec).

Modelled, for `--far` nodes on so many machines: the CPU of a machine is that of its share of the nodes. Where nodes lie
next to each other (grid) the border of a part grows with the root of its size, elsewhere with its size. Not in the
model: what it costs to send and to take in bytes, which `python -m benchmarks.shards` measures, and waiting.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import truth_of, views_of
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.graph import Graph
from hedgerow.topologies.load import load
from hedgerow.topologies.partition import partition
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import REPORT_ROWS, encode_input, encode_state, telemetry_bytes

GRAPHS = {"grid": 0.5, "random_regular": 1.0}
"""By graph: the power of its size that the border of a part grows with."""
STEPS, WARM_UP = 13, 3


class Step(NamedTuple):
    """CPU seconds of a step."""

    plant: float
    agents: float


class Border(NamedTuple):
    """Where parts of a graph meet, on average over the parts."""

    nodes: float
    """of a part that have a neighbour in another"""
    parts: float
    """that are its neighbours"""
    said: float
    """nodes that stand in its link messages, once for each part that hears them"""


def network(graph: str, nodes: int, folder: Path) -> Topology:
    """A network with three candidates and a sinusoid a node."""
    file = folder / f"{graph}.yaml"
    degree = ", degree: 3" if graph == "random_regular" else ""
    file.write_text(
        f"{{name: {graph}, b: 0.1, steps: {STEPS}, seed: 1, graph: {{kind: {graph}, nodes: {nodes}{degree}}},"
        " defaults: {x0: 10, candidates: {random: 3},"
        " disturbance: {kind: sinusoid, amplitude: 1, omega: {random: [0, 3.14159]}}}}\n"
    )
    return resolve(load(str(file)), folder)


def step(truth: Truth, view: View) -> Step:
    """What plant and agents spend on a step, in this process."""
    world, shard = World(truth), Shard(view)
    spent = np.zeros(2)
    for t in range(truth.steps):
        if t == WARM_UP:
            spent[:] = 0
        marks = [time.process_time()]
        world.begin()
        ((state, _),) = world.states()
        marks.append(time.process_time())
        assert state is not None
        u = shard.answer(state)
        marks.append(time.process_time())
        world.step(u, shard.report, [shard.took])
        marks.append(time.process_time())
        spent += [marks[1] - marks[0] + marks[3] - marks[2], marks[2] - marks[1]]
    return Step(*(spent / (truth.steps - WARM_UP)).tolist())


def border(graph: Graph, parts: Sequence[np.ndarray]) -> Border:
    """What crosses between the parts."""
    home = np.empty(graph.n, dtype=np.int64)
    for p, nodes in enumerate(parts):
        home[nodes] = p
    here, there = home[graph.node], home[graph.neighbour]
    across = here != there
    node, to = graph.node[across], there[across]
    pairs = np.unique(here[across] * len(parts) + to)
    said = np.unique(node * len(parts) + to)
    return Border(len(np.unique(node)) / len(parts), len(pairs) / len(parts), len(said) / len(parts))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, default=10**6, help="of the network that is measured")
    parser.add_argument("--far", type=int, default=10**8, help="of the one that is not")
    parser.add_argument("--machines", type=int, default=100)
    known = parser.parse_args()
    n, far, machines = known.nodes, known.far, known.machines
    nothing = np.zeros(1)
    header = len(encode_state(0, nothing, b"")) - 8
    # Edges of the far network do not lengthen what has nothing wrong to tell.
    told = 8
    said = len(encode_input(0, nothing, np.zeros((REPORT_ROWS, 1)), b"")) - header
    seen = telemetry_bytes(1, 0) - header
    columns = []
    for graph, power in GRAPHS.items():
        with TemporaryDirectory(prefix="hedgerow-") as scratch:
            topology = network(graph, n, Path(scratch))
            whole = [np.arange(n)]
            cost = step(truth_of(topology, whole), views_of(topology, whole)[0])
            met = border(topology.graph, partition(topology.graph, machines))
        grown = (far / n) ** power
        # Link messages carry x and u of a node; a plant that is cut up needs u alone, once for each part.
        crossing_bytes = met.said * grown * (16 + 8)
        columns.append(
            {
                f"measured at {n:,} nodes: plant [ns of CPU a node]": f"{cost.plant / n * 1e9:.0f}",
                "agents [ns of CPU a node]": f"{cost.agents / n * 1e9:.0f}",
                f"one plant at {far:,}: CPU a step [s]": f"{cost.plant / n * far:.1f}",
                "its states, inputs and telemetry a step [GB]": f"{far * (told + said + seen) / 1e9:.1f}",
                f"one of {machines} machines: CPU of plant and agents a step [ms]": (
                    f"{(cost.plant + cost.agents) / n * far / machines * 1e3:.0f}"
                ),
                "nodes with a neighbour elsewhere": f"{met.nodes * grown:,.0f}",
                "machines that it has neighbours on": f"{met.parts:.1f}",
                "messages to and from them a step": f"{4 * met.parts:.0f}",
                "to them a step [MB]": f"{crossing_bytes / 1e6:.2f}",
            }
        )
    print(f"| | {' | '.join(GRAPHS)} |")
    print("|---|" + "---|" * len(GRAPHS))
    for name in columns[0]:
        print(f"| {name} | {' | '.join(column[name] for column in columns)} |")


if __name__ == "__main__":
    main()
