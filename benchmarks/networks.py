"""The cost of large networks from the file to the processes: `python -m benchmarks.networks`, one row per graph and
size.

Each row is a separate process: CPU seconds for each stage, and its peak memory. With `--unequal` each network also has
a random gain for every node and a random weight for every edge, and a row of ratios follows.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import truth_of, views_of
from hedgerow.orchestrator.runs.reference import run
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.hinf import gamma_star
from hedgerow.topologies.load import load
from hedgerow.topologies.partition import cut, partition
from hedgerow.topologies.resolve import resolve, save

GRAPHS = {
    "ring": "kind: ring",
    "random_regular": "kind: random_regular, degree: 3",
    "grid": "kind: grid",
    "random_tree": "kind: random_tree, max_degree: 3",
    "scale_free": "kind: scale_free, attach: 2, max_degree: 10",
}
STAGES = ("load", "resolve", "partition", "gamma*", "write", "read", "steps", "load again")
STEPS = 20
"""the number of steps of all shards and of the plant, after two that are not counted"""
UNEQUAL = (", weight: {random: [0.5, 1]}", "b: {random: [0.05, 0.1]}, ")
"""under `graph:` and under `defaults:`"""


def measure(graph: str, nodes: int, processes: int, unequal: bool = False) -> dict[str, float]:
    """Return the CPU seconds by stage, the peak memory [MB], and the share of the edges between processes."""
    spent: dict[str, float] = {}

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        began = time.process_time()
        yield
        spent[name] = time.process_time() - began

    with tempfile.TemporaryDirectory(prefix="hedgerow-") as scratch:
        folder = Path(scratch)
        file = folder / "big.yaml"
        weight, gain = UNEQUAL if unequal else ("", "")
        file.write_text(
            f"{{name: big, b: 0.1, steps: 100, seed: 1, graph: {{{graph}, nodes: {nodes}{weight}}}, "
            f"defaults: {{{gain}x0: {{random: [5, 15]}}, disturbance: {{kind: white, std: 0.1}}}}}}\n"
        )
        with stage("load"):
            written = load(str(file))
        with stage("resolve"):
            network = resolve(written, folder)
        with stage("partition"):
            shards = partition(network.graph, processes)
        with stage("gamma*"):
            gamma_star(network.network.a, network.b, network.graph)
        with stage("write"):
            save(network, folder / "topology.yaml")
            truth_of(network, shards).write(folder / "plant.npz")
            for view in views_of(network, shards):
                view.write(folder / f"{view.shard}.npz")
        with stage("read"):
            truth = Truth.read(folder / "plant.npz")
            views = [View.read(folder / f"{p}.npz") for p in range(processes)]
            World(truth)
            for view in views:
                Shard(view)
        rows = run(truth, views)
        next(rows), next(rows)
        with stage("steps"):
            for _ in range(STEPS):
                next(rows)
        del rows
        with stage("load again"):
            load(str(folder))
        deliveries = cut(network.graph, shards) / max(1, len(network.edges))
    return spent | {"MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "cut": deliveries}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[10**4, 10**5, 10**6])
    parser.add_argument("--graphs", nargs="+", choices=GRAPHS, default=[*GRAPHS])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--unequal", action="store_true", help="also with gains and weights that differ, and ratios")
    parser.add_argument("--one", action="store_true", help="measure the first graph and size here, as JSON")
    known = parser.parse_args()
    if known.one:
        print(json.dumps(measure(GRAPHS[known.graphs[0]], known.sizes[0], known.processes, known.unequal)))
        return
    print(f"| graph | nodes | {' | '.join(f'{stage} [s]' for stage in STAGES)} | all [s] | memory [MB] | edges cut |")
    print("|---|" + "---|" * (len(STAGES) + 4))
    for graph in known.graphs:
        for nodes in known.sizes:
            uniform = _measured(graph, nodes, known.processes, unequal=False)
            _show(graph, nodes, uniform)
            if known.unequal:
                unequal = _measured(graph, nodes, known.processes, unequal=True)
                _show(f"{graph}, unequal", nodes, unequal)
                _show("ratio", nodes, {key: unequal[key] / max(uniform[key], 1e-3) for key in unequal})


def _measured(graph: str, nodes: int, processes: int, unequal: bool) -> dict[str, float]:
    """Return the numbers of one network, measured in a separate process."""
    command = [sys.executable, "-m", "benchmarks.networks", "--one", "--graphs", graph, "--sizes", str(nodes)]
    command += ["--processes", str(processes), *(["--unequal"] if unequal else [])]
    # Use one thread, so that the CPU seconds are those of an idle machine.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    row: dict[str, float] = json.loads(output)
    return row | {"all": sum(row[stage] for stage in STAGES)}


def _show(name: str, nodes: int, row: dict[str, float]) -> None:
    shown = " | ".join(f"{row[stage]:.2f}" for stage in (*STAGES, "all"))
    memory = f"{row['MB']:.2f}" if name == "ratio" else f"{row['MB']:.0f}"
    crossing = f"{row['cut']:.2f}" if name == "ratio" else f"{row['cut']:.2%}"
    print(f"| {name} | {nodes:,} | {shown} | {memory} | {crossing} |", flush=True)


if __name__ == "__main__":
    main()
