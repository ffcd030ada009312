"""The rules that a schema cannot say: the graph is a graph, condition (3) holds, and faults strike what there is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

from topologies.base import node_id
from topologies.errors import Problem
from topologies.faults import Crash, Cut, Delay, Drop, Fault, Jump, Partition
from topologies.hinf import allowed_interval, satisfies_condition
from topologies.samples import columns
from topologies.schema import Samples, Topology
from topologies.source import Path, Source, place_of


def broken_rules(topology: Topology, source: Source, folder: FilePath) -> list[Problem]:
    """Every rule that `topology` breaks, each where the file says it."""
    return [
        *_edges(topology, source),
        *_nodes(topology, source),
        *_disturbances(topology, source, folder),
        *_processes(topology, source),
        *broken_faults(topology, source),
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


@dataclass(frozen=True)
class _Named:
    """A node of the file, to say what is wrong with one of its settings, where the file gives it."""

    id: int | str
    topology: Topology
    source: Source

    def problem(self, key: str, what: str, cure: str, *inside: int) -> Problem:
        own = getattr(self.topology.nodes[self.id], key) is not None
        inherited = not own and getattr(self.topology.defaults, key) is not None
        path = ("defaults",) if inherited else ("nodes", self.id)
        return Problem(self.source.line((*path, key, *inside)), f"node {self.id}: {key}", what, cure)


def _nodes(topology: Topology, source: Source) -> Iterator[Problem]:
    degrees = _degrees(topology)
    for node in topology.ids:
        yield from _condition_3(_Named(node, topology, source), topology.b, degrees[node])
        yield from _truth(_Named(node, topology, source))


def _condition_3(node: _Named, b: float, degree: int) -> Iterator[Problem]:
    interval = allowed_interval(b, degree)
    if interval is None:
        room = max(0, math.ceil(1 / (8 * b * b)) - 1)
        load = f"8 b² d = {8 * b * b * degree:.4g} is not below 1 (b = {b:g}, degree {degree})"
        cure = f"give it at most {room} neighbours, or b below {1 / math.sqrt(8 * degree):.4g}"
        line = node.source.line(("nodes", node.id))
        yield Problem(line, f"node {node.id}", f"{load}: no a satisfies condition (3)", cure)
        return
    settings = node.topology.settings(node.id)
    listed = settings.candidates if isinstance(settings.candidates, tuple) else ()
    values: list[tuple[str, Any, tuple[int, ...]]] = [("candidates", value, (m,)) for m, value in enumerate(listed)]
    values.append(("nominal", settings.nominal, ()))
    if not listed:  # a truth that must be among the candidates is judged with them
        values.append(("a", settings.a, ()))
    why = f"({interval[0]:.6g}, {interval[1]:.6g}), the interval of condition (3) for b = {b:g} and degree {degree}"
    for key, value, inside in values:
        if isinstance(value, float) and not satisfies_condition(value, b, degree):
            yield node.problem(key, f"{value!r} is outside {why}", "choose a value inside it", *inside)


def _truth(node: _Named) -> Iterator[Problem]:
    settings = node.topology.settings(node.id)
    if (
        isinstance(settings.candidates, tuple)
        and isinstance(settings.a, float)
        and settings.a not in settings.candidates
    ):
        shown = ", ".join(f"{value:g}" for value in settings.candidates[:12])
        what = f"the truth {settings.a!r} is not among the candidates [{shown}]"
        yield node.problem("a", what, "add it to them, or choose one of them")


def _disturbances(topology: Topology, source: Source, folder: FilePath) -> Iterator[Problem]:
    own = [
        (node, settings.disturbance) for node, settings in topology.nodes.items() if settings.disturbance is not None
    ]
    if topology.disturbance is not None:
        for node, _ in own:
            line = source.line(("nodes", node, "disturbance"))
            what = "stands beside the network's own `disturbance:`, which replaces every node's"
            yield Problem(line, f"node {node}: disturbance", what, "remove one of the two")
    inherits = [node for node, settings in topology.nodes.items() if settings.disturbance is None]
    places: list[tuple[Path, Any, list[int | str]]] = [(("nodes", node), given, [node]) for node, given in own]
    places.append((("defaults",), topology.defaults.disturbance, inherits))
    for path, given, nodes in places:
        for part in given if isinstance(given, tuple) else (given,):
            if isinstance(part, Samples):
                place = (*path, "disturbance")
                for what, cure in _samples(part, nodes, topology, folder):
                    yield Problem(source.line(place), place_of(place), what, cure)


def _samples(part: Samples, nodes: list[int | str], topology: Topology, folder: FilePath) -> Iterator[tuple[str, str]]:
    if part.values is not None:
        yield from _long_enough({len(part.values)}, topology.steps)
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


def _processes(topology: Topology, source: Source) -> Iterator[Problem]:
    if topology.processes is not None and topology.processes > len(topology.nodes):
        what = f"{topology.processes} are too many for {len(topology.nodes)} nodes"
        yield Problem(source.line(("processes",)), "processes", what, f"give at most {len(topology.nodes)}")


def broken_faults(topology: Topology, source: Source | None = None) -> list[Problem]:
    """Every rule that the faults of `topology` break; without `source`, on no line."""
    if not topology.faults:
        return []
    struck = _Struck(topology)
    if source is not None and len(source.value.get("edges") or ()) != len(topology.edges):
        struck.neighbours = None
    return [
        Problem(source.line(path) if source else 0, place_of(path), what, cure)
        for k, fault in enumerate(topology.faults)
        for inside, what, cure in struck.missing(fault)
        for path in [("faults", k, *inside)]
    ]


class _Struck:
    """What there is to be struck by a fault."""

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        self.neighbours: dict[int | str, dict[int | str, None]] | None = {node: {} for node in topology.ids}
        """In the order of the edges; None where the schema refused some: nobody knows what they were to be."""
        for i, j in topology.edges:
            self.neighbours.setdefault(i, {})[j] = None
            self.neighbours.setdefault(j, {})[i] = None

    def missing(self, fault: Fault) -> Iterator[tuple[Path, str, str]]:
        """What the fault strikes that is not there: where it says so, what is wrong, and the cure."""
        for path, node in _named_nodes(fault):
            if node not in self.topology.nodes:
                yield path, f"{node!r} is no node", f"the nodes are {_listed(self.topology.ids)}"
        for path, (i, j) in _named_pairs(fault):
            if self.neighbours is None or not {i, j} <= self.topology.nodes.keys():
                continue
            near = self.neighbours[i]
            if j not in near:
                cure = f"the neighbours of {i} are {_listed([*near])}" if near else f"{i} has no neighbours"
                yield path, f"{i} and {j} are not neighbours", cure
        if isinstance(fault, Crash) and fault.process is not None:
            processes = self.topology.processes or len(self.topology.nodes)
            if fault.process >= processes:
                yield ("process",), f"there is no process {fault.process}", f"they are 0 to {processes - 1}"
        if isinstance(fault, Jump) and fault.node in self.topology.nodes:
            candidates = self.topology.settings(fault.node).candidates
            if isinstance(candidates, tuple) and fault.a != "random" and fault.a not in candidates:
                shown = _listed(candidates)
                yield ("a",), f"{fault.a!r} is not among the candidates of node {fault.node}", f"they are {shown}"


def _named_nodes(fault: Fault) -> Iterator[tuple[Path, int | str]]:
    """Every node that a fault names, and where."""
    if isinstance(fault, Partition):
        yield from ((("groups", g, m), node) for g, group in enumerate(fault.groups) for m, node in enumerate(group))
    elif isinstance(fault, Drop | Delay | Cut):
        for path, pair in _named_pairs(fault):
            ends = [("from",), ("to",)] if path == ("to",) else [path, path]
            yield from dict.fromkeys(zip(ends, pair, strict=True))
    elif fault.node is not None:
        yield ("node",), fault.node


def _named_pairs(fault: Fault) -> Iterator[tuple[Path, tuple[int | str, int | str]]]:
    """Every link or edge that a fault names, and where."""
    if isinstance(fault, Drop | Delay) and fault.link is not None:
        yield ("link",), fault.link
    if isinstance(fault, Drop | Delay) and fault.from_ is not None and fault.to is not None:
        yield ("to",), (fault.from_, fault.to)
    if isinstance(fault, Cut) and fault.edge is not None:
        yield ("edge",), fault.edge
    if isinstance(fault, Drop | Cut) and fault.at is not None:
        yield from ((("at", step, m), pair) for step, pairs in fault.at.items() for m, pair in enumerate(pairs))


def _listed(values: Sequence[float | str]) -> str:
    return ", ".join(map(str, values[:12])) + (", …" if len(values) > 12 else "")
