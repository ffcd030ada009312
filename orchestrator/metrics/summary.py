"""What `orchestrator check` shows of a topology that passed."""

from __future__ import annotations

import itertools

from rich.console import Console
from rich.table import Table

from hedgerow.orchestrator.ground.assignment import candidates_of
from hedgerow.topologies.hinf import allowed_interval, contraction, gamma_star
from hedgerow.topologies.partition import cut, partition, pieces
from hedgerow.topologies.resolve import truth
from hedgerow.topologies.schema import LAWS, Component, Topology

MAX_ROWS = 200


def table(topology: Topology) -> str:
    """A resolved topology as a table, a row a node, with gamma* and rho below."""
    graph, a = topology.graph, truth(topology)
    rows = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("node", "degree", "allowed interval", "candidates", "truth", "x0", "disturbance"):
        rows.add_column(heading, overflow="fold")
    for (node, own), degree in itertools.islice(zip(topology.nodes.items(), graph.degree, strict=True), MAX_ROWS):
        interval = allowed_interval(topology.b, int(degree))
        parts = own.disturbance if isinstance(own.disturbance, tuple) else (own.disturbance,)
        rows.add_row(
            str(node),
            str(degree),
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
        size = f"{count(graph.n, 'node')}, {count(len(graph.edges), 'edge')}{apart}, b = {topology.b:g}"
        gamma, rho = gamma_star(a, topology.b, graph), contraction(a, candidates_of(topology))
        held = f"; rho = {rho:.6g}, the contraction whatever is estimated" if topology.law in LAWS else ""
        processes = topology.process_count
        cut_edges = cut(graph, partition(graph, processes))
        console.print(
            f"\n{topology.name}: {size}, {topology.steps} steps, seed {topology.seed}, law {topology.law}\n"
            f"gamma* = {gamma:.6g}, the optimal gain when every a is known{held}\n"
            f"{count(processes, 'process', 'es')}; {cut_edges} of {count(len(graph.edges), 'edge')} from one to another"
        )
    return capture.get().rstrip()


def count(number: int, thing: str, plural: str = "s") -> str:
    """A number of things, in words."""
    return f"{number} {thing}{plural if number != 1 else ''}"


def _shown(part: Component) -> str:
    values = part.model_dump(exclude={"kind"}, exclude_none=True)
    inside = ", ".join(
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {_long(value)}" for key, value in values.items()
    )
    return f"{part.kind} {inside}".strip()


def _long(value: object) -> str:
    return f"({len(value)})" if isinstance(value, tuple) else str(value)
