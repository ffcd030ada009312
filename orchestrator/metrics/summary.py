"""The output of `orchestrator check` for a valid topology."""

from __future__ import annotations

import itertools

import numpy as np
from rich.console import Console
from rich.table import Table

from hedgerow.orchestrator.ground.assignment import candidates_of
from hedgerow.topologies.describe import count
from hedgerow.topologies.disturbances import Component
from hedgerow.topologies.hinf import allowed_interval, contraction, gamma_star
from hedgerow.topologies.law_choice import is_listed
from hedgerow.topologies.network import span
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.partition import cut, cut_weight, pieces
from hedgerow.topologies.resolve import truth
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.settings import Drawn

MAX_ROWS = 200


def table(topology: Topology) -> str:
    """Return a resolved topology as a table, one row per node, with gamma* and rho below."""
    graph, a, b = topology.graph, truth(topology), topology.network.b
    unequal = graph.weights is not None or not isinstance(b, float)
    rows = Table(box=None, pad_edge=False, header_style="bold")
    own_numbers = ("b", "weighted degree") if unequal else ()
    headings = ("node", "degree", *own_numbers, "allowed interval", "candidates", "truth", "x0", "disturbance")
    for heading in headings:
        rows.add_column(heading, overflow="fold")
    gains, degrees = np.broadcast_to(b, graph.n), graph.weighted_degree
    of_nodes = zip(topology.nodes.items(), gains, graph.degree, degrees, strict=True)
    for k, ((_, own), gain, degree, weighted) in enumerate(itertools.islice(of_nodes, MAX_ROWS)):
        interval = allowed_interval(float(gain), float(weighted))
        parts = own.disturbance if isinstance(own.disturbance, tuple) else (own.disturbance,)
        rows.add_row(
            topology.network.title(k),
            str(degree),
            *((f"{gain:.4g}", f"{weighted:.4g}") if unequal else ()),
            "({:.4f}, {:.4f})".format(*interval) if interval else "none",
            " ".join(f"{value:.4f}" for value in own.candidates or ()),
            f"{own.a:.4f}",
            f"{own.x0:g}",
            " + ".join(_shown(part) for part in parts if part is not None) or "none",
        )
    console = Console(width=160, no_color=True, highlight=False, markup=False, emoji=False)
    with console.capture() as capture:
        console.print(rows)
        if graph.n > MAX_ROWS:
            console.print(f"… and {graph.n - MAX_ROWS} nodes more")
        apart = f" in {islands} pieces" if (islands := len(pieces(graph))) > 1 else ""
        size = f"{count(graph.n, 'node')}, {count(len(graph.edges), 'edge')}{apart}, b = {span(b)}"
        if graph.weights is not None:
            size += f", weights {span(graph.weights)}"
        gamma, rho = gamma_star(a, b, graph), contraction(a, candidates_of(topology))
        held = f"; rho = {rho:.6g}, the contraction whatever is estimated" if is_listed(topology.law) else ""
        processes = topology.process_count
        shards = topology.parts
        crossing = f"{cut(graph, shards)} of {count(len(graph.edges), 'edge')} from one to another"
        if graph.weights is not None:
            crossing += f", of weight {cut_weight(graph, shards):.4g} of {graph.weights.sum():.4g}"
        console.print(
            f"\n{topology.name}: {size}, {topology.steps} steps, seed {topology.seed}, law {topology.law}\n"
            f"gamma* = {gamma:.6g}, the optimal gain when every a is known{held}\n"
            f"{count(processes, 'process', 'es')}; {crossing}"
        )
    return capture.get().rstrip()


def replaced(given: Topology) -> list[str]:
    """Return a line if the truth of a node replaces one of its drawn candidates; `given` has no number drawn yet."""
    if isinstance(given.nodes, Nodes):
        return []
    nodes = [
        f"{node} ({own.a:g})"
        for node, own in given.nodes.items()
        if isinstance(own.a, float) and isinstance(given.behind(own).candidates, Drawn)
    ]
    if not nodes:
        return []
    listed = ", ".join(nodes[:8]) + (", …" if len(nodes) > 8 else "")
    return [f"the given truth replaces one of the drawn candidates at {count(len(nodes), 'node')}: {listed}"]


def _shown(part: Component) -> str:
    values = part.model_dump(exclude={"kind"}, exclude_none=True)
    inside = ", ".join(
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {_long(value)}" for key, value in values.items()
    )
    return f"{part.kind} {inside}".strip()


def _long(value: object) -> str:
    return f"({len(value)})" if isinstance(value, tuple) else str(value)
