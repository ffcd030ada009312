"""Our graphs and pictures beside those of igraph: `python -m benchmarks.graphs`; it needs `pip install igraph`.

A separate process measures each number, three times. The first table has seconds of CPU and memory for the edges as
an array, by the rule of a topology file and by igraph's generator of the same kind. The second table has the time and
the stress of pictures: the mean squared relative error of the distances on paper, at the best scale.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from hedgerow.orchestrator.views.layout import positions
from hedgerow.topologies.generators import GENERATORS
from hedgerow.topologies.graph import Array, Graph, Index

PICTURES = {
    "grid": 100,
    "small_world": 100,
    "scale_free": 100,
    "random_tree": 200,
    "geometric": 400,
    "random_regular": 1000,
}
"""by kind: the numbers of nodes"""
SEED = 1


def ours(kind: str, nodes: int) -> Index:
    """Return the edges by the rule of a topology file, (E, 2)."""
    return GENERATORS[kind](nodes=nodes).edges(SEED)


def igraphs(kind: str, nodes: int) -> Index:
    """Return the edges by igraph's generator with the parameters of our defaults, (E, 2)."""
    import igraph  # noqa: PLC0415

    random.seed(SEED)  # igraph draws from Python's generator
    side = math.ceil(math.sqrt(nodes))
    radius = math.sqrt(6 / (math.pi * nodes))
    makers: dict[str, Callable[[], Any]] = {
        "line": lambda: igraph.Graph.Lattice([nodes], circular=False),
        "ring": lambda: igraph.Graph.Ring(nodes),
        "star": lambda: igraph.Graph.Star(nodes),
        "grid": lambda: igraph.Graph.Lattice([side, side], circular=False),
        "tree": lambda: igraph.Graph.Tree(nodes, 2),
        "random_tree": lambda: igraph.Graph.Growing_Random(nodes, 1, citation=True),
        "random_regular": lambda: igraph.Graph.K_Regular(nodes, 3),
        "small_world": lambda: igraph.Graph.Watts_Strogatz(1, nodes, 2, 0.1),
        "scale_free": lambda: igraph.Graph.Barabasi(nodes, 2),
        "geometric": lambda: igraph.Graph.GRG(nodes, radius),
    }
    return np.array(makers[kind]().get_edgelist(), dtype=np.int64).reshape(-1, 2)


def by_igraph(graph: Graph) -> Array:
    """Return the places of igraph's Kamada-Kawai layout, (n, 2)."""
    import igraph  # noqa: PLC0415

    random.seed(SEED)
    return np.array(igraph.Graph(graph.n, graph.edges.tolist()).layout_kamada_kawai().coords)


def stress(graph: Graph, places: Array) -> float:
    """Return the mean of (|x_i - x_j|/d_ij - 1)^2 over the pairs of one piece, at the scale that makes it least."""
    matrix = csr_array((np.ones(len(graph.node)), (graph.node, graph.neighbour)), (graph.n, graph.n))
    far = shortest_path(matrix, unweighted=True)
    i, j = np.triu_indices(graph.n, 1)
    apart = np.isfinite(far[i, j])
    ratio = (np.hypot(*(places[i] - places[j]).T) / far[i, j])[apart]
    return float(((ratio * ratio.sum() / (ratio**2).sum() - 1) ** 2).mean())


def measure(what: str, kind: str, nodes: int) -> dict[str, float]:
    """Return the seconds of CPU, and MB or stress."""
    if what in ("ours", "igraph"):
        make = {"ours": ours, "igraph": igraphs}[what]
        make(kind, 20)  # loads what it needs
        before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        edges = make(kind, nodes)
        spent = time.process_time() - began
        return {
            "s": spent,
            "MB": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024,
            "edges": len(edges),
        }
    graph = Graph(nodes, ours(kind, nodes))
    place: Callable[[Graph], Array] = positions if what == "our picture" else by_igraph
    place(Graph(20, ours(kind, 20)))
    began = time.process_time()
    places = place(graph)
    return {"s": time.process_time() - began, "stress": stress(graph, places)}


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--nodes", type=int, default=10**6)
    parser.add_argument("--kinds", nargs="+", choices=GENERATORS, default=[*GENERATORS])
    parser.add_argument("--one", nargs=2, help="measure this kind by this maker here, as JSON")
    known = parser.parse_args()
    if known.one:
        print(json.dumps(measure(known.one[1], known.one[0], known.nodes)))
        return
    print("| graph | edges | ours [s] | igraph [s] | ratio | ours [MB] | igraph [MB] |")
    print("|---|---|---|---|---|---|---|")
    for kind in known.kinds:
        one, other = (_measured(kind, what, known.nodes) for what in ("ours", "igraph"))
        print(
            f"| {kind} | {one['edges']:,.0f} | {one['s']:.2f} | {other['s']:.2f} | {one['s'] / other['s']:.2f} "
            f"| {one['MB']:.0f} | {other['MB']:.0f} |",
            flush=True,
        )
    print("\n| picture of | nodes | ours [s] | igraph [s] | stress of ours | stress of igraph's |")
    print("|---|---|---|---|---|---|")
    for kind, nodes in PICTURES.items():
        one, other = (_measured(kind, what, nodes) for what in ("our picture", "igraph's picture"))
        print(
            f"| {kind} | {nodes} | {one['s']:.2f} | {other['s']:.2f} | {one['stress']:.4f} | {other['stress']:.4f} |",
            flush=True,
        )


def _measured(kind: str, what: str, nodes: int) -> dict[str, float]:
    """Return the median of three separate processes, by seconds."""
    command = [sys.executable, "-m", "benchmarks.graphs", "--one", kind, what, "--nodes", str(nodes)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    rows: Sequence[dict[str, float]] = [
        json.loads(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
        for _ in range(3)
    ]
    return sorted(rows, key=lambda row: row["s"])[1]


if __name__ == "__main__":
    main()
