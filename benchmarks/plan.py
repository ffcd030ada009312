"""`python -m benchmarks.plan`: the cost of a step beyond this machine, by a model with numbers that are measured here.

Measured: the CPU seconds per node and step of the plant and the agents, in one process at `--nodes` nodes. Also
measured, for a graph of that size in `--machines` parts: the nodes with a neighbour in another part, and the pairs of
neighbouring parts. Known: the bytes of every message (wire.codec).

Modelled, for `--far` nodes on the same number of machines: the CPU time of a machine is that of its share of the nodes.
In a grid, the border of a part grows with the root of its size; in other graphs, it grows with its size. The model
leaves out the cost to send and to receive bytes, which `python -m benchmarks.shards` measures, and waiting.
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
from hedgerow.wire.codec import encode_input, encode_state, telemetry_bytes
from hedgerow.wire.message import REPORT_ROWS

GRAPHS = {"grid": 0.5, "random_regular": 1.0}
"""By graph: the exponent of a part's size in the size of its border."""
STEPS, WARM_UP = 13, 3


class Step(NamedTuple):
    """The CPU seconds of a step."""

    plant: float
    agents: float


class Border(NamedTuple):
    """The borders between parts of a graph, as means over the parts."""

    nodes: float
    """the nodes of a part with a neighbour in another part"""
    parts: float
    """the number of its neighbouring parts"""
    sent: float
    """the nodes in its link messages, counted once for each receiving part"""


def network(graph: str, nodes: int, folder: Path) -> Topology:
    """Return a network with three candidates and a sinusoid per node."""
    file = folder / f"{graph}.yaml"
    degree = ", degree: 3" if graph == "random_regular" else ""
    file.write_text(
        f"{{name: {graph}, b: 0.1, steps: {STEPS}, seed: 1, graph: {{kind: {graph}, nodes: {nodes}{degree}}},"
        " defaults: {x0: 10, candidates: {random: 3},"
        " disturbance: {kind: sinusoid, amplitude: 1, omega: {random: [0, 3.14159]}}}}\n"
    )
    return resolve(load(str(file)), folder)


def step(truth: Truth, view: View) -> Step:
    """Return the CPU seconds of plant and agents for a step, in this process."""
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
        world.step(u, shard.report, [shard.used])
        marks.append(time.process_time())
        spent += [marks[1] - marks[0] + marks[3] - marks[2], marks[2] - marks[1]]
    return Step(*(spent / (truth.steps - WARM_UP)).tolist())


def border(graph: Graph, parts: Sequence[np.ndarray]) -> Border:
    """Return the sizes of the borders between the parts."""
    home = np.empty(graph.n, dtype=np.int64)
    for p, nodes in enumerate(parts):
        home[nodes] = p
    here, there = home[graph.node], home[graph.neighbour]
    across = here != there
    node, to = graph.node[across], there[across]
    pairs = np.unique(here[across] * len(parts) + to)
    sent = np.unique(node * len(parts) + to)
    return Border(len(np.unique(node)) / len(parts), len(pairs) / len(parts), len(sent) / len(parts))


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
    # In a quiet step, the edges of the far network do not lengthen a message.
    state = 8
    reply = len(encode_input(0, nothing, np.zeros((REPORT_ROWS, 1)), b"")) - header
    seen = telemetry_bytes(1, 0) - header
    columns = []
    for graph, power in GRAPHS.items():
        with TemporaryDirectory(prefix="hedgerow-") as scratch:
            topology = network(graph, n, Path(scratch))
            whole = [np.arange(n)]
            cost = step(truth_of(topology, whole), views_of(topology, whole)[0])
            met = border(topology.graph, partition(topology.graph, machines))
        grown = (far / n) ** power
        # Link messages carry x and u of a node; a divided plant needs only u, once for each part.
        crossing_bytes = met.sent * grown * (16 + 8)
        columns.append(
            {
                f"measured at {n:,} nodes: plant [ns of CPU a node]": f"{cost.plant / n * 1e9:.0f}",
                "agents [ns of CPU a node]": f"{cost.agents / n * 1e9:.0f}",
                f"one plant at {far:,}: CPU a step [s]": f"{cost.plant / n * far:.1f}",
                "its states, inputs and telemetry a step [GB]": f"{far * (state + reply + seen) / 1e9:.1f}",
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
