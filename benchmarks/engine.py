"""`python -m benchmarks.engine`: a step in one process, from 10^2 to 10^6 nodes, beside a plain step in numpy.

The network is a ring with three candidates and a sinusoid per node. The plain step is careful standard code. It
computes the state, the input, the flow (by bincount or as a sparse product; the faster one counts), J of all
candidates, and the best of them. Ours does this twice, as plant and as agents, with telemetry, margins, and support for
faults. Both give the same trajectory, bit for bit; the benchmark checks this.

Every round runs each in turn. The table gives medians over the rounds, of CPU time and of the ratios within a round.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse

from benchmarks.table import show
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import HISTORY_BYTES
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.truth import Truth
from hedgerow.topologies.fast import LARGE, kernels_for
from hedgerow.topologies.graph import Array, Graph
from hedgerow.topologies.network import Group
from hedgerow.wire.message import Telemetry

B = 0.1
CANDIDATES = 3
SIZES = [10**2, 10**3, 10**4, 10**5, 10**6]
NODE_STEPS, MOST_STEPS = 10_000_000, 50_000
"""The number of nodes times steps of a measurement, and the maximum number of steps.

Runs of 100 and of 1000 nodes are then long enough for compiled loops.
"""
WARM_UP = 3
"""the number of steps that are not counted: they allocate memory and load loops"""


class Ring(NamedTuple):
    """The network of the benchmark."""

    truth: Truth
    view: View
    graph: Graph

    @property
    def wave(self) -> dict[str, Array]:
        """Return amplitude, omega and phase of each node's sinusoid."""
        return dict(self.truth.disturbance[0].values)


def ring(n: int, steps: int) -> Ring:
    """Return a ring of n nodes, in one shard."""
    random = np.random.default_rng(1)
    candidates = random.uniform(0.1, 0.9, (CANDIDATES, n))
    nodes = np.arange(n)
    wave = {"amplitude": np.ones(n), "omega": random.uniform(0, np.pi, n), "phase": np.zeros(n)}
    edges = np.stack([nodes, (nodes + 1) % n], axis=1)
    graph = Graph(n, edges)
    history = min(100_000, max(1, HISTORY_BYTES // (8 * (3 * n + 2 * n))))
    truth = Truth(
        ids=nodes,
        b=B,
        a=candidates[random.integers(0, CANDIDATES, n), nodes],
        x0=np.full(n, 10.0),
        edges=edges,
        disturbance=[Group(0, "sinusoid", nodes, wave)],
        steps=steps,
        seed=1,
        shards=[nodes],
        effects=[],
        faults=0,
        history=history,
    )
    view = View(
        shard=0,
        b=B,
        law="minimax",
        ids=nodes,
        candidates=candidates,
        row=graph.node,
        column=graph.neighbour,
        peers=[],
        outside=np.empty(0, dtype=np.int64),
        history=history,
    )
    return Ring(truth, view, graph)


def plain(network: Ring, sparse: bool) -> tuple[float, Array]:
    """Return the CPU time of a step in numpy [s], and the last state."""
    truth, candidates, graph = network.truth, network.view.candidates, network.graph
    n, a = graph.n, truth.a
    amplitude, omega, phase = (network.wave[key] for key in ("amplitude", "omega", "phase"))
    degree = graph.degree.astype(float)
    ones = np.ones(len(graph.node))
    adjacency = scipy.sparse.csr_array((ones, (graph.node, graph.neighbour)), shape=(n, n))
    x, nodes = truth.x0, np.arange(n)
    J = np.zeros_like(candidates)
    ahat = candidates[0]
    began = 0.0
    for t in range(truth.steps):
        if t == WARM_UP:
            began = time.process_time()
        u = B * x / (ahat - 1)
        if sparse:
            f = degree * u - adjacency @ u
        else:
            f = np.bincount(graph.node, u[graph.node] - u[graph.neighbour], n).astype(float, copy=False)
        x_next = a * x + B * f + amplitude * np.sin(omega * t + phase)
        J += (candidates * x - (x_next - B * f)) ** 2
        ahat = candidates[J.argmin(axis=0), nodes]
        x = x_next
    return (time.process_time() - began) / (truth.steps - WARM_UP), x


def ours(network: Ring) -> tuple[float, Array]:
    """Return the same for the in-process engine."""
    began, x = 0.0, network.truth.x0
    for row in reference.run(network.truth, [network.view]):
        if row.t == WARM_UP - 1 and isinstance(row, Telemetry):
            began = time.process_time()
        x = row.x
    return (time.process_time() - began) / (network.truth.steps - WARM_UP), x


def bytes_per_node(n: int) -> float:
    """Return the peak memory of the engine, measured in a separate process [bytes/node]."""
    command = [sys.executable, "-m", "benchmarks.engine", "--memory", str(n)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _peak() -> int:
    """Return the peak memory of this process [bytes]; getrusage may give that of its parent."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def _memory(n: int) -> None:
    for _ in reference.run(*_run_of(LARGE)):  # load everything that is loaded once
        pass
    before = _peak()
    for _ in reference.run(*_run_of(n)):
        pass
    print((_peak() - before) / n)


def _run_of(n: int) -> tuple[Truth, list[View]]:
    network = ring(n, 20)
    return network.truth, [network.view]


def measure(n: int, rounds: int, steps: int | None = None) -> dict[str, float]:
    """Return one row of the table."""
    network = ring(n, WARM_UP + (steps or max(10, min(MOST_STEPS, NODE_STEPS // n))))
    runs = []
    for _ in range(rounds):
        by_bincount, x = plain(network, sparse=False)
        by_product, _ = plain(network, sparse=True)
        engine, x_ours = ours(network)
        if x.tobytes() != x_ours.tobytes():
            raise SystemExit(f"{n} nodes: the trajectories differ")
        runs.append((min(by_bincount, by_product), engine))
    plain_s, ours_s = (statistics.median(each) for each in zip(*runs, strict=True))
    return {
        "nodes": n,
        "plain steps/s": 1 / plain_s,
        "ours steps/s": 1 / ours_s,
        "ours / plain": statistics.median(one / other for one, other in runs),
        "ns a node and step": ours_s / n * 1e9,
        "bytes a node": bytes_per_node(n) if n >= 10**5 else float("nan"),
    }


def main() -> None:
    """Print the table, or JSON with `--json`."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, help="steps of a run; compiled loops need long runs below 4096 nodes")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--memory", type=int, help=argparse.SUPPRESS)
    known = parser.parse_args()
    if known.memory:
        _memory(known.memory)
        return
    loops = "compiled loops" if kernels_for(LARGE) is not None else "numpy alone: numba is not installed"
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, {loops}", file=sys.stderr)
    show((measure(n, known.rounds, known.steps) for n in known.nodes), 20, known.json)


if __name__ == "__main__":
    main()
