"""The rules beyond the schema: the graph is valid, condition (3) holds, and the targets of faults exist."""

from __future__ import annotations

import difflib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from hedgerow.topologies.base import node_id
from hedgerow.topologies.coupling import Couplings, largest_couplings, largest_gains
from hedgerow.topologies.disturbances import Samples
from hedgerow.topologies.errors import Code, FileRefusedError, Problem, Problems
from hedgerow.topologies.faults import Crash, Fault, Jump
from hedgerow.topologies.graph import Index
from hedgerow.topologies.hinf import allowed_interval, satisfies_condition
from hedgerow.topologies.nodes import Edges, Nodes
from hedgerow.topologies.reading import Reading
from hedgerow.topologies.samples import columns
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.source import Path, Source, place_of
from hedgerow.topologies.table import broken

MOST_COMPARED = 1000
"""The maximum number of nodes for a comparison of their ids with a wrong id."""


def broken_rules(topology: Topology, source: Source, folder: FilePath) -> Iterator[Problem]:
    """Find every rule that `topology` breaks, with its place in the file."""
    if not topology.ids:
        if "nodes" not in source.value:  # otherwise the schema reports the problem
            yield Problem(0, "", "`nodes:` is missing", "add `nodes: …`, or `graph: {kind: …, nodes: …}`")
        return
    yield from _sources(topology, source)
    yield from _edges(topology, source)
    yield from _nodes(topology, source)
    yield from _disturbances(topology, source, folder)
    yield from _processes(topology, source)
    yield from _recorded(topology, source)
    yield from broken_faults(topology, source)


def _sources(topology: Topology, source: Source) -> Iterator[Problem]:
    """Check that the file gives the edges only once, and that overridden nodes exist."""
    written = [key for key in ("graph", "table", "edges") if key in source.value]
    for key in written[1:] if len(written) > 1 else ():
        what = f"conflicts with `{written[0]}:`, which gives all edges"
        yield source.problem((key,), what, "keep one of the two")
    if topology.table_nodes is not None and "table" not in source.value:
        yield source.problem(("table_nodes",), "is about a `table:`, which is missing", "remove it, or add the table")
    if topology.given is not None and len(written) == 1:
        defaults = topology.defaults
        a = defaults.a if isinstance(defaults.a, float) else None
        candidates = defaults.candidates if isinstance(defaults.candidates, tuple) else None
        for what, cure in broken(topology.given, largest_gains(topology), topology.steps, a, candidates):
            yield source.problem(("table",), what, cure)
        if topology.disturbance is not None and topology.given.disturbance:
            what = "conflicts with the disturbances of `table:`, which it replaces"
            yield source.problem(("disturbance",), what, "remove one of the two")
    yield from _without_effect(topology, source)
    for node in topology.nodes if isinstance(topology.ids, range) and written[:1] != ["edges"] else ():
        if not topology.has(node):
            what, cure = f"{node!r} is none of its nodes", f"they are 0 to {len(topology.ids) - 1}"
            yield source.problem(("nodes", node), what, cure)


def _without_effect(topology: Topology, source: Source) -> Iterator[Problem]:
    """Find the defaults of the command line that no node uses: in a resolved file, each node has its own value."""
    paths: list[Path] = [("defaults", key) for key in topology.defaults.model_fields_set]
    for path in [*paths, ("b",)]:
        key = str(path[-1])
        if not source.mark(path).origin or getattr(topology if path == ("b",) else topology.defaults, key) is None:
            continue
        by = ""
        if path == ("b",) and topology.defaults.b is not None:
            by = "`defaults:` give the gain"
        elif topology.given is not None and getattr(topology.given, key) is not None:
            by = "the table has a value for each node"
        elif len(topology.nodes) == len(topology.ids) and all(
            getattr(own, key) is not None for own in topology.nodes.values()
        ):
            by = "each node has its own value"
        if by:
            node = topology.ids[0]
            yield source.problem(path, f"has no effect: {by}", f"write nodes.{node}.{key} for one node")


def _edges(topology: Topology, source: Source) -> Iterator[Problem]:
    if _made(topology):
        return
    seen: dict[frozenset[int | str], int] = {}
    strange: dict[int | str, str] = {}
    # The topology lacks edges that the schema refused: find the lines of the remaining ones by their ends.
    rows = _rows(topology, source) if topology.edges else []
    for (i, j), k in zip(topology.pairs, rows, strict=True):
        at = ("edges", k)
        for end in dict.fromkeys((i, j)):
            if not topology.has(end):
                what = f"[{i}, {j}] leads to {end!r}, which is no node"
                if end not in strange:
                    strange[end] = _cure_of_end(end, topology, similar=len(strange) < Problems.SHOWN)
                yield source.problem(at, what, strange[end])
        if i == j:
            yield source.problem(at, f"[{i}, {j}] is a self-loop", "remove it")
        elif (first := seen.setdefault(frozenset((i, j)), k)) != k:
            what = f"[{i}, {j}] is already on line {source.line(('edges', first))}"
            yield source.problem(at, what, "edges are undirected: keep one")


def _cure_of_end(end: int | str, topology: Topology, similar: bool) -> str:
    """Return the fix for an id of an edge that does not exist; 7 and 007 differ, and are easily confused.

    similar: look for a node with a similar id, which takes time for each node.
    """
    if isinstance(end, str) and end.isdecimal() and topology.has(int(end)):
        return f"write {int(end)}, the node, or add a node {end!r}"
    if similar and isinstance(end, str) and len(topology.ids) <= MOST_COMPARED:
        near = difflib.get_close_matches(end, [one for one in topology.ids if isinstance(one, str)], 1)
        if near:
            return f"did you mean {near[0]!r}? Correct the id or add the node"
    return "add the node or correct the id"


def _rows(topology: Topology, source: Source) -> list[int]:
    if len(topology.edges) == len(written := source.value.get("edges") or []):
        return list(range(len(written)))
    ends = ((k, edge.get("ends") if isinstance(edge, dict) else edge) for k, edge in enumerate(written))
    pairs = iter([(k, pair) for k, pair in ends if isinstance(pair, list)])
    return [next(k for k, pair in pairs if [*map(node_id, pair)] == list(edge)) for edge in topology.pairs]


def _made(topology: Topology) -> bool:
    """Return True if a rule made the edges, or they come in columns: they are valid then."""
    return topology.generator is not None or topology.given is not None or isinstance(topology.edges, Edges)


@dataclass(frozen=True)
class _Named:
    """A node of the file, for messages about its settings at their place in the file."""

    id: int | str
    topology: Topology
    source: Source

    def in_table(self, *keys: str) -> bool:
        """Return True if all of these values come from the table, and `broken` checks it in columns."""
        own, table = self.topology.nodes.get(self.id), self.topology.given
        return table is not None and all(
            getattr(table, key) is not None and getattr(own, key, None) is None for key in keys
        )

    def problem(self, key: str, what: str, cure: str, *inside: int) -> Problem:
        own = getattr(self.topology.nodes.get(self.id), key, None) is not None
        inherited = not own and getattr(self.topology.defaults, key) is not None
        path = ("defaults",) if inherited else ("nodes", self.id)
        return self.source.problem((*path, key, *inside), what, cure, place=f"node {self.id}: {key}")


def _nodes(topology: Topology, source: Source) -> Iterator[Problem]:
    if isinstance(topology.nodes, Nodes):
        return  # complete in columns: topologies.table has checked them
    couplings = largest_couplings(topology, made=_made(topology))
    if len(empty := couplings.empty):
        yield _no_interval(topology, source, couplings, empty)
    for node in _judged(topology, couplings):
        k = topology.position(node)
        yield from _condition_3(_Named(node, topology, source), float(couplings.b[k]), float(couplings.degree[k]))
        yield from _truth(_Named(node, topology, source))


def _judged(topology: Topology, couplings: Couplings) -> Iterator[int | str]:
    """Return the nodes to check. The others hold if these do: condition (3) is hardest for the largest b_i^2 d_i."""
    if not _made(topology):
        yield from topology.ids
        return
    own = [node for node in topology.nodes if topology.has(node)]
    yield from own
    coupling = couplings.b * couplings.b * couplings.degree
    coupling[[topology.position(node) for node in own]] = -1
    if len(own) < len(coupling):
        yield topology.ids[int(coupling.argmax())]


def _no_interval(topology: Topology, source: Source, couplings: Couplings, empty: Index) -> Problem:
    """Name the nodes for which no a satisfies condition (3), and the largest b that suits all nodes."""
    coupling = couplings.b * couplings.b * couplings.degree
    order = (-coupling[empty]).argsort(kind="stable")
    worst = int(empty[order[0]])
    names = [str(topology.ids[k]) for k in empty[order[:6]].tolist()]
    b, degree = couplings.b[worst], couplings.degree[worst]
    load = f"8 b² d = {8 * coupling[worst]:.4g} is not below 1 (b = {b:g}, degree {degree:.6g})"
    fewer = f"lower the degree below {1 / (8 * b * b):.4g}"
    cure = f"the largest b that fits all nodes is {couplings.largest_b:.4g}; or {fewer}"
    if len(empty) == 1:
        path: Path = ("nodes", topology.ids[worst])
        return source.problem(path, f"{load}: no a satisfies condition (3)", cure, place=f"node {names[0]}")
    listed = ", ".join(names) + (", …" if len(empty) > len(names) else "")
    what = f"no a satisfies condition (3) at {len(empty)} nodes ({listed}); at node {names[0]}, {load}"
    path = ("b",) if topology.defaults.b is None else ("defaults", "b")
    return source.problem(path, what, cure)


def _condition_3(node: _Named, b: float, degree: float) -> Iterator[Problem]:
    interval = allowed_interval(b, degree)
    if interval is None:
        return
    settings = node.topology.settings(node.id)
    listed = settings.candidates if isinstance(settings.candidates, tuple) else ()
    values: list[tuple[str, Any, tuple[int, ...]]] = [("candidates", value, (m,)) for m, value in enumerate(listed)]
    values.append(("nominal", settings.nominal, ()))
    if not listed:  # a truth that must be a candidate is checked with the candidates
        values.append(("a", settings.a, ()))
    of = f"b = {b:g} and {'degree' if float(degree).is_integer() else 'weighted degree'} {degree:.6g}"
    why = f"({interval[0]:.6g}, {interval[1]:.6g}), the interval of condition (3) for {of}"
    for key, value, inside in values:
        if isinstance(value, float) and not satisfies_condition(value, b, degree) and not node.in_table(key):
            yield node.problem(key, f"{value!r} is outside {why}", "choose a value inside it", *inside)


def _truth(node: _Named) -> Iterator[Problem]:
    settings = node.topology.settings(node.id)
    if (
        isinstance(settings.candidates, tuple)
        and isinstance(settings.a, float)
        and settings.a not in settings.candidates
        and not node.in_table("a", "candidates")
    ):
        shown = ", ".join(f"{value:g}" for value in settings.candidates[:12])
        what = f"the truth {settings.a!r} is not among the candidates [{shown}]"
        yield node.problem("a", what, "add it to them, or choose one of them")


def _disturbances(topology: Topology, source: Source, folder: FilePath) -> Iterator[Problem]:
    if isinstance(topology.nodes, Nodes):
        return
    own = [
        (node, settings.disturbance) for node, settings in topology.nodes.items() if settings.disturbance is not None
    ]
    if topology.disturbance is not None:
        for node, _ in own:
            what = "conflicts with the network's `disturbance:`, which replaces that of every node"
            yield source.problem(("nodes", node, "disturbance"), what, "remove one of the two")
    places: list[tuple[Path, Any, list[int | str]]] = [(("nodes", node), given, [node]) for node, given in own]
    if topology.defaults.disturbance is not None:
        theirs = dict(own)
        inherits = [node for node in topology.ids if node not in theirs]
        places.append((("defaults",), topology.defaults.disturbance, inherits))

    @cache  # every node may name the same file
    def table(reading: Reading) -> dict[int | str, list[float]] | FileRefusedError:
        try:
            return columns(reading.file, folder, topology.ids, reading.header, reading.times, topology.named_files)
        except ValueError as error:
            return FileRefusedError.of(error)

    for path, given, nodes in places:
        for part in given if isinstance(given, tuple) else (given,):
            if isinstance(part, Samples):
                place = (*path, "disturbance")
                for what, cure, code in _samples(part, nodes, topology.steps, table):
                    yield source.problem(place, what, cure, code)


def _samples(
    part: Samples,
    nodes: list[int | str],
    steps: int,
    read: Callable[[Reading], dict[int | str, list[float]] | FileRefusedError],
) -> Iterator[tuple[str, str, Code]]:
    if part.values is not None:
        yield from _long_enough(len(part.values), steps)
    elif part.file is not None:
        table = read(part.reading)
        if isinstance(table, FileRefusedError):
            yield table.what, table.cure, table.code
            return
        if missing := [node for node in nodes if node not in table]:
            yield (
                f"{part.file} has no column for {', '.join(map(str, missing[:8]))}",
                "name the columns by node ids in its first row",
                Code.FILE_FORMAT,
            )
        yield from _long_enough(len(next(iter(table.values()))), steps)


def _long_enough(samples: int, steps: int) -> Iterator[tuple[str, str, Code]]:
    if samples < steps:
        yield f"{samples} samples are too few for {steps} steps", "add samples or lower `steps:`", Code.TOPOLOGY


def _processes(topology: Topology, source: Source) -> Iterator[Problem]:
    if (n := len(topology.ids)) < topology.process_count:
        what = f"{topology.processes} are too many for {n} nodes"
        yield source.problem(("processes",), what, f"give at most {n}")
    elif topology.layout is not None and (wrong := _no_layout(topology.layout, n, topology.process_count)):
        yield source.problem(("layout",), wrong, "write `layout: null`, and a partition of the graph replaces it")


def _no_layout(layout: Sequence[int], n: int, processes: int) -> str:
    """Return what is wrong with a layout of n nodes over processes, or nothing."""
    if len(layout) != n:
        return f"has {len(layout)} entries for {n} nodes"
    used = set(layout)
    if max(used) >= processes:
        return f"names process {max(used)}, and they are 0 to {processes - 1}"
    empty = next((process for process in range(processes) if process not in used), None)
    return "" if empty is None else f"leaves process {empty} without a node"


def _recorded(topology: Topology, source: Source) -> Iterator[Problem]:
    listed = topology.record.nodes
    for k, node in enumerate(listed if isinstance(listed, tuple) else ()):
        path = ("record", "nodes", k)
        if not topology.has(node):
            cure = f"the nodes are {_listed(topology.ids)}"
            yield source.problem(path, f"{node!r} is no node", cure)


def broken_faults(topology: Topology, source: Source | None = None) -> list[Problem]:
    """Return every rule that the faults of `topology` break; without `source`, with no line."""
    if not topology.faults:
        return []
    struck = _Struck(topology)
    written = source.value.get("edges") or [] if source is not None and not _made(topology) else topology.edges
    # The schema refused some of them, or all.
    if not isinstance(written, Sequence) or len(written) != len(topology.edges):
        struck.certain = False
    return [
        source.problem(path, what, cure) if source else Problem(0, place_of(path), what, cure)
        for k, fault in enumerate(topology.faults)
        for inside, what, cure in struck.missing(fault)
        for path in [("faults", k, *inside)]
    ]


class _Struck:
    """The possible targets of a fault."""

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        self.certain = True
        """False if the schema refused some edges: their intended ends are unknown."""

    @cached_property
    def _written(self) -> dict[int | str, dict[int | str, None]]:
        """Return the neighbours of each node, in the order of the edges."""
        beside: dict[int | str, dict[int | str, None]] = defaultdict(dict)
        for i, j in self.topology.pairs:
            beside[i][j] = None
            beside[j][i] = None
        return beside

    def neighbours(self, node: int | str) -> list[int | str]:
        """Return the neighbours of one node."""
        if not _made(self.topology):
            return [*self._written[node]]
        graph, k = self.topology.graph, self.topology.position(node)
        first, stop = np.searchsorted(graph.node, [k, k + 1])
        return [self.topology.ids[j] for j in graph.neighbour[first:stop].tolist()]

    def missing(self, fault: Fault) -> Iterator[tuple[Path, str, str]]:
        """Yield each target of the fault that does not exist: its place, the problem, and the fix."""
        has = self.topology.has
        for path, node in _named_nodes(fault):
            if not has(node):
                yield path, f"{node!r} is no node", f"the nodes are {_listed(self.topology.ids)}"
        for path, (i, j) in _named_pairs(fault):
            if not (self.certain and has(i) and has(j)):
                continue
            near = self.neighbours(i)
            if j not in near:
                cure = f"the neighbours of {i} are {_listed(near)}" if near else f"{i} has no neighbours"
                yield path, f"{i} and {j} are not neighbours", cure
        if isinstance(fault, Crash) and fault.process is not None:
            processes = self.topology.process_count
            if fault.process >= processes:
                yield ("process",), f"there is no process {fault.process}", f"they are 0 to {processes - 1}"
        if isinstance(fault, Jump) and has(fault.node):
            candidates = self.topology.settings(fault.node).candidates
            if isinstance(candidates, tuple) and fault.a != "random" and fault.a not in candidates:
                shown = _listed(candidates)
                # `check` prints four decimals, and a jump needs all digits.
                asked, known = float(fault.a), np.array(candidates, dtype=float)
                meant = float(known[np.abs(known - asked).argmin()])
                cure = f"did you mean {meant!r}? " if abs(meant - asked) < 1e-3 else ""
                what = f"{fault.a!r} is not among the candidates of node {fault.node}"
                yield ("a",), what, f"{cure}they are {shown}"


def _named_nodes(fault: Fault) -> Iterator[tuple[Path, int | str]]:
    """Yield every node that a fault names, with its place; a key means the same in every kind of fault."""
    for g, group in enumerate(getattr(fault, "groups", ())):
        yield from ((("groups", g, m), node) for m, node in enumerate(group))
    for path, pair in _named_pairs(fault):
        ends = [("from",), ("to",)] if path == ("to",) else [path, path]
        yield from dict.fromkeys(zip(ends, pair, strict=True))
    if (node := getattr(fault, "node", None)) is not None:
        yield ("node",), node


def _named_pairs(fault: Fault) -> Iterator[tuple[Path, tuple[int | str, int | str]]]:
    """Yield every link or edge that a fault names, with its place."""
    for key in ("link", "edge"):
        if (pair := getattr(fault, key, None)) is not None:
            yield (key,), pair
    if (sender := getattr(fault, "from_", None)) is not None:
        yield ("to",), (sender, getattr(fault, "to", sender))
    if isinstance(table := getattr(fault, "at", None), Mapping):
        yield from ((("at", step, m), pair) for step, pairs in table.items() for m, pair in enumerate(pairs))


def _listed(values: Sequence[float | str]) -> str:
    return ", ".join(map(str, values[:12])) + (", …" if len(values) > 12 else "")
