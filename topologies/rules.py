"""The rules that a schema cannot say: the graph is a graph, and condition (3) holds at every node."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath

from topologies.errors import Problem
from topologies.hinf import allowed_interval, satisfies_condition
from topologies.samples import columns
from topologies.schema import Node, Samples, Topology, node_id
from topologies.source import Source, place_of


def broken_rules(topology: Topology, source: Source, folder: FilePath) -> list[Problem]:
    """Every rule that `topology` breaks, each where the file says it."""
    return [
        *_edges(topology, source),
        *_nodes(topology, source),
        *_disturbances(topology, source, folder),
    ]


def _edges(topology: Topology, source: Source) -> Iterator[Problem]:
    seen: dict[frozenset[int | str], int] = {}
    # Edges that the schema refused are not in the topology: find the others' lines by their ends.
    rows = _rows(topology, source) if topology.edges else []
    for (i, j), k in zip(topology.edges, rows, strict=True):
        line, place = source.line(("edges", k)), place_of(("edges", k))
        for end in dict.fromkeys((i, j)):
            if end not in topology.nodes:
                yield Problem(
                    line,
                    place,
                    f"[{i}, {j}] leads to {end!r}, which is no node",
                    "add the node or mend the id",
                )
        if i == j:
            yield Problem(line, place, f"[{i}, {j}] is a self-loop", "remove it")
        elif (first := seen.setdefault(frozenset((i, j)), k)) != k:
            yield Problem(
                line,
                place,
                f"[{i}, {j}] stands already on line {source.line(('edges', first))}",
                "edges are undirected: keep one",
            )


def _rows(topology: Topology, source: Source) -> list[int]:
    if len(topology.edges) == len(written := source.value.get("edges") or []):
        return list(range(len(written)))
    pairs = iter([(k, pair) for k, pair in enumerate(written) if isinstance(pair, list)])
    return [next(k for k, pair in pairs if [*map(node_id, pair)] == list(edge)) for edge in topology.edges]


def _degrees(topology: Topology) -> Counter[int | str]:
    good = {frozenset(edge) for edge in topology.edges if edge[0] != edge[1]}
    return Counter(end for edge in good for end in edge)


def _nodes(topology: Topology, source: Source) -> Iterator[Problem]:
    degrees, b = _degrees(topology), topology.b
    for node in topology.ids:
        settings, degree = topology.settings(node), degrees[node]

        def problem(key: str, what: str, cure: str, *inside: int, node: int | str = node) -> Problem:
            own = getattr(topology.nodes[node], key) is not None
            path = ("nodes", node) if own or getattr(topology.defaults, key) is None else ("defaults",)
            return Problem(source.line((*path, key, *inside)), f"node {node}: {key}", what, cure)

        interval = allowed_interval(b, degree)
        if interval is None:
            line, room = source.line(("nodes", node)), max(0, math.ceil(1 / (8 * b * b)) - 1)
            what = f"8 b² d = {8 * b * b * degree:.4g} is not below 1 (b = {b:g}, degree {degree}): no a satisfies condition (3)"
            yield Problem(
                line,
                f"node {node}",
                what,
                f"give it at most {room} neighbours, or b below {1 / math.sqrt(8 * degree):.4g}",
            )
            continue
        bounds = f"({interval[0]:.6g}, {interval[1]:.6g})"
        why = f"the interval of condition (3) for b = {b:g} and degree {degree}"

        def outside(
            key: str,
            value: float,
            *inside: int,
            problem: Callable[..., Problem] = problem,
            bounds: str = bounds,
            why: str = why,
        ) -> Problem:
            what = f"{value!r} is outside {bounds}, {why}"
            return problem(key, what, "choose a value inside it", *inside)

        listed = settings.candidates if isinstance(settings.candidates, tuple) else ()
        for m, value in enumerate(listed):
            if not satisfies_condition(value, b, degree):
                yield outside("candidates", value, m)
        if isinstance(settings.a, float):
            if listed and settings.a not in listed:
                shown = ", ".join(f"{value:g}" for value in listed[:12])
                yield problem(
                    "a",
                    f"the truth {settings.a!r} is not among the candidates [{shown}]",
                    "add it to them, or choose one of them",
                )
            elif not listed and not satisfies_condition(settings.a, b, degree):
                yield outside("a", settings.a)
        if settings.nominal is not None and not satisfies_condition(settings.nominal, b, degree):
            yield outside("nominal", settings.nominal)


def _disturbances(topology: Topology, source: Source, folder: FilePath) -> Iterator[Problem]:
    if topology.disturbance is not None:
        for node, own in topology.nodes.items():
            if own.disturbance is not None:
                line = source.line(("nodes", node, "disturbance"))
                what = "stands beside the network's own `disturbance:`, which replaces every node's"
                yield Problem(line, f"node {node}: disturbance", what, "remove one of the two")
    places: list[tuple[tuple[str | int, ...], Node, list[int | str]]] = [
        (("nodes", node), own, [node]) for node, own in topology.nodes.items()
    ]
    inherit = [node for node, own in topology.nodes.items() if own.disturbance is None]
    places.append((("defaults",), topology.defaults, inherit))
    for path, settings, nodes in places:
        parts = settings.disturbance if isinstance(settings.disturbance, tuple) else (settings.disturbance,)
        for part in parts:
            if isinstance(part, Samples):
                place = (*path, "disturbance")
                for what, cure in _samples(part, nodes, topology, folder):
                    yield Problem(source.line(place), place_of(place), what, cure)
        for field in _ranges(settings):
            for name, low, high in field:
                place = (*path, name)
                yield Problem(
                    source.line(place),
                    place_of(place),
                    f"random: [{low:g}, {high:g}] is empty",
                    "put the lower bound first",
                )


def _ranges(settings: Node) -> Iterator[list[tuple[str, float, float]]]:
    parts = settings.disturbance if isinstance(settings.disturbance, tuple) else (settings.disturbance,)
    for name, model in (
        ("x0", settings),
        *(("disturbance", part) for part in parts if part is not None),
    ):
        values = [model.x0] if isinstance(model, Node) else [getattr(model, key) for key in type(model).model_fields]
        yield [(name, v.low, v.high) for v in values if hasattr(v, "random") and v.low > v.high]


def _samples(part: Samples, nodes: list[int | str], topology: Topology, folder: FilePath) -> Iterator[tuple[str, str]]:
    if (part.values is None) == (part.file is None):
        yield "samples have either `values:` or `file:`", "give exactly one of them"
    elif part.values is not None:
        lengths = {len(part.values)}
        yield from _long_enough(lengths, topology.steps)
    elif part.file is not None:
        try:
            table = columns(part.file, folder, topology.ids)
        except ValueError as error:
            yield str(error), "one column a node, numbers only"
            return
        if missing := [node for node in nodes if node not in table]:
            yield (
                f"{part.file} has no column for {', '.join(map(str, missing[:8]))}",
                "name the columns by node ids in its first row",
            )
        yield from _long_enough({len(column) for column in table.values()}, topology.steps)


def _long_enough(lengths: set[int], steps: int) -> Iterator[tuple[str, str]]:
    if short := [n for n in lengths if n < steps]:
        yield f"{min(short)} samples are too few for {steps} steps", "add samples or lower `steps:`"
