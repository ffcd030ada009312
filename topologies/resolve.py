"""The draw of random values: the resolved topology has a number for each of them.

Each number has a separate lot, a function of (seed, node id, field): `topologies.lots`. Another order of the nodes, or
an added node, does not change the numbers of other nodes.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from hedgerow.topologies import lots, table
from hedgerow.topologies.base import Uniform
from hedgerow.topologies.disturbances import Confuse, Disturbance, Nothing, Samples
from hedgerow.topologies.edges import Edge
from hedgerow.topologies.errors import Code, HedgerowError, TopologyError, UserError
from hedgerow.topologies.faults import Crash, Fault, Jump
from hedgerow.topologies.graph import Array, Index
from hedgerow.topologies.hinf import allowed_intervals, smallest_eigenpair
from hedgerow.topologies.network import PARAMETERS, Group, Network, gains, labels
from hedgerow.topologies.nodes import SPELLED_OUT, Edges, Nodes
from hedgerow.topologies.partition import layout_of
from hedgerow.topologies.reading import Reading
from hedgerow.topologies.record import SAMPLED, WHOLE
from hedgerow.topologies.rules import broken_faults
from hedgerow.topologies.samples import columns
from hedgerow.topologies.schema import PER_NODE, Topology
from hedgerow.topologies.settings import Defaults, Drawn, Node
from hedgerow.topologies.source import FLOAT, OTHER_WHOLE
from hedgerow.topologies.table import Table


class _Draws:
    """Uniform numbers in [0, 1), one or more for each node, by field.

    With S seeds there are S copies of the n nodes, one after another, each drawn from its own seed.
    """

    def __init__(self, topology: Topology, seeds: Sequence[int]) -> None:
        self._words = lots.words_of(topology.ids)
        self._seeds = np.array(seeds, dtype=np.uint64)[:, None]
        given = topology.lots
        known = given is not None and given.seed in seeds and [k for k, seed in enumerate(seeds) if seed == given.seed]
        self._given = {} if given is None or not known else given.nodes
        n = len(self._words)
        self._position = {
            node: [topology.position(node) + n * k for k in known or ()] for node in self._given if topology.has(node)
        }
        self._drawn: dict[tuple[str, int], Array] = {}

    def of(self, field: str, nodes: Index, width: int = 1) -> Array:
        """Return the numbers of these nodes, (k, width)."""
        if (field, width) not in self._drawn:
            keys = lots.keys(self._seeds, field, self._words).ravel()
            drawn = np.empty((len(keys), width))
            for start in range(0, len(keys), lots.BLOCK):
                some = slice(start, start + lots.BLOCK)
                for member in range(width):
                    drawn[some, member] = lots.uniforms(lots.at(keys[some], np.array([member])))
            for node, places in self._position.items():
                given = self._given[node].get(field, ())[:width]
                drawn[places, : len(given)] = given
            self._drawn[field, width] = drawn
        return self._drawn[field, width][nodes]

    def at(self, field: str, node: int, step: int) -> float:
        """Return the number of the node at this position, at a step."""
        keys = lots.keys(self._seeds[0], field, self._words[node : node + 1])
        return float(lots.uniforms(lots.at(keys, np.array([step])))[0])

    def value(self, value: float | Uniform, field: str, nodes: Index) -> Array:
        """Return a fixed or random value for these nodes, (k,)."""
        if not isinstance(value, Uniform):
            return np.full(len(nodes), value, dtype=float)
        return value.low + (value.high - value.low) * self.of(field, nodes)[:, 0]


def resolve(topology: Topology, folder: Path = Path()) -> Topology:
    """Return the same network with every number drawn and every node listed; a second call changes nothing.

    `folder` holds the CSV files of `samples`. The topology must have passed `topologies.rules`. Raise TopologyError for
    a fault that breaks them; a jump is checked here, with the candidates drawn.
    """
    draws = _Draws(topology, [topology.seed])
    network = topology.network if isinstance(topology.nodes, Nodes) else _Drawing(topology, draws, folder).network()
    if topology.disturbance is not None:
        network = _worst_case(network, topology.disturbance.energy)
    if len(network.ids) <= SPELLED_OUT:
        network = replace(network, ids=tuple(network.ids))
        whole: dict[str, Any] = {"nodes": dict(Nodes(network)), "edges": tuple(Edges(network))}
    else:
        whole = {"nodes": Nodes(network), "edges": Edges(network)}
    whole |= {"generator": None, "table": None, "table_nodes": None, "lots": None}
    whole |= {"defaults": Defaults(), "disturbance": None}
    if topology.processes == "auto" or (topology.processes is None and len(network.ids) > PER_NODE):
        whole["processes"] = topology.process_count
    if topology.record.nodes is None and len(network.ids) > WHOLE:
        whole["record"] = topology.record.model_copy(update={"nodes": SAMPLED})
    if topology.layout is None and any(isinstance(one, Crash) and one.process is not None for one in topology.faults):
        # A machine without METIS cuts a large network otherwise, and the fault would strike other nodes there.
        whole["layout"] = layout_of(network.graph, topology.process_count)
    drawn = topology.model_copy(update=whole).of_network(network)
    if problems := broken_faults(drawn):
        raise TopologyError(topology.name, problems)
    if any(isinstance(fault, Jump) and fault.a == "random" for fault in drawn.faults):
        drawn = drawn.model_copy(update={"faults": _jumps(drawn, draws)})
    return drawn


def copies(topology: Topology, seeds: Sequence[int], folder: Path = Path()) -> Network:
    """Return S copies of a network as one network of S n nodes, each copy as `resolve` draws it from its seed.

    The copies follow one another, and `graph` is the graph of one of them. The topology must have a graph, gains and
    weights that do not depend on the seed.
    """
    return _Drawing(topology, _Draws(topology, seeds), folder, len(seeds)).network()


class _Drawing:
    """The columns of a network, or of several copies of it; nodes with equal settings are filled together."""

    def __init__(self, topology: Topology, draws: _Draws, folder: Path, copies: int = 1) -> None:
        self._topology, self._draws, self._folder, self._copies = topology, draws, folder, copies
        self._n = len(topology.ids)
        n = self._n * copies
        self._b, self._a, self._x0, self._nominal = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
        self._parts = np.empty(n, dtype=np.int64)
        self._lists: list[tuple[Index, Array]] = []
        """(nodes, candidates (M, k)), NaN-padded"""
        self._groups: dict[tuple[int, str], list[Group]] = defaultdict(list)
        self._files: dict[Reading, dict[int | str, list[float]]] = {}

    def network(self) -> Network:
        """Return the filled network."""
        topology, table = self._topology, self._topology.given
        written = [(node, own) for node, own in topology.nodes.items() if own != Node()]
        own_nodes = np.array([topology.position(node) for node, _ in written], dtype=np.int64)
        others = np.ones(self._n * self._copies, dtype=bool)
        each = self._n * np.arange(self._copies)
        others[(own_nodes[:, None] + each).ravel()] = False
        self._fill(Node(), np.flatnonzero(others), table)
        for (_, own), k in zip(written, own_nodes, strict=True):
            self._fill(own, k + each, table)
        candidates = np.full((max(len(listed) for _, listed in self._lists), len(others)), np.nan)
        for nodes, listed in self._lists:
            candidates[: len(listed), nodes] = listed
        return Network(
            ids=topology.ids,
            graph=topology.graph,
            b=gains(self._b),
            a=self._a,
            x0=self._x0,
            nominal=self._nominal,
            candidates=candidates,
            disturbance=[_joined(found) for _, found in sorted(self._groups.items(), key=lambda item: item[0])],
            parts=self._parts,
            labels=self._labels(table) if self._copies == 1 else None,
            positions=self._positions(table) if self._copies == 1 else None,
        )

    def _labels(self, table: Table | None) -> Sequence[str] | None:
        topology = self._topology
        found: list[str | None] = [""] * len(topology.ids)
        if table is not None and table.labels is not None:
            found[:] = table.labels
        for node, own in topology.nodes.items():
            if own.label is not None:
                found[topology.position(node)] = own.label
        return labels(found)

    def _positions(self, table: Table | None) -> Array | None:
        topology = self._topology
        found = np.full((len(topology.ids), 2), np.nan)
        if table is not None and table.positions is not None:
            found[:] = table.positions
        for node, own in topology.nodes.items():
            if own.position is not None:
                found[topology.position(node)] = own.position
        return None if np.isnan(found).all() else found

    def _fill(self, own: Node, nodes: Index, table: Table | None) -> None:
        """Fill the columns of nodes with these own settings; gaps come from the table, and then from the defaults."""
        if not len(nodes):
            return
        settings: Any = self._topology.behind(own)  # the built-in defaults leave no gap

        def column(key: str) -> Array | None:
            found: Array | None = getattr(table, key) if table is not None and getattr(own, key) is None else None
            return None if found is None else found[..., nodes % self._n]

        x0, nominal, listed, a, b = (column(key) for key in ("x0", "nominal", "candidates", "a", "b"))
        self._b[nodes] = self._draws.value(settings.b, "b", nodes) if b is None else b
        self._x0[nodes] = self._draws.value(settings.x0, "x0", nodes) if x0 is None else x0
        self._nominal[nodes] = settings.nominal if nominal is None else nominal
        if a is None and isinstance(settings.a, float):
            a = np.full(len(nodes), settings.a)
        self._model(nodes, settings.candidates, listed, a)
        if table is not None and table.disturbance is not None and own.disturbance is None:
            assert table.parts is not None
            self._parts[nodes] = table.parts[nodes % self._n]
            steps = self._topology.steps
            for group in table.disturbance:
                # Positions of `nodes` with a node in the group, and their rows in the group.
                row = np.searchsorted(group.nodes, nodes % self._n).clip(max=len(group.nodes) - 1)
                here = group.nodes[row] == nodes % self._n if len(group.nodes) else np.zeros(len(nodes), dtype=bool)
                values = {
                    key: array[row[here], :steps] if key == "values" else array[row[here]]
                    for key, array in group.values.items()
                }
                self._add(group.number, group.kind, nodes[here], values)
        else:
            self._disturb(nodes, settings.disturbance)

    def _model(self, nodes: Index, asked: Drawn | Sequence[float], listed: Array | None, a: Array | None) -> None:
        """Fill the candidates and the truth; a given truth replaces one of the drawn candidates."""
        k = np.arange(len(nodes))
        pick = self._draws.of("a", nodes)[:, 0]
        if listed is not None:
            lengths: Any = (~np.isnan(listed)).sum(axis=0)
        elif isinstance(asked, Drawn):
            lengths = asked.random
            low, high = allowed_intervals(self._b[nodes], self._topology.graph.weighted_degree[nodes % self._n])
            listed = low + (high - low) * self._draws.of("candidates", nodes, lengths).T
            if a is not None:
                apart = np.flatnonzero(~(listed == a).any(axis=0))
                listed[(pick[apart] * lengths).astype(np.int64), apart] = a[apart]
        else:
            lengths = len(asked)
            listed = np.repeat(np.array(asked, dtype=float)[:, None], len(nodes), axis=1)
        self._lists.append((nodes, listed))
        self._a[nodes] = listed[(pick * lengths).astype(np.int64), k] if a is None else a

    def _disturb(self, nodes: Index, disturbance: Disturbance) -> None:
        parts = disturbance if isinstance(disturbance, tuple) else (disturbance,)
        self._parts[nodes] = len(parts)
        for number, part in enumerate(parts):
            if isinstance(part, Samples):
                values = {"values": self._samples(part, nodes)}
            elif isinstance(part, Confuse) and part.candidate == "random":
                values = {"candidate": self._wrong(nodes, f"disturbance.{number}.candidate")}
            else:
                field = f"disturbance.{number}"
                values = {
                    key: np.full(len(nodes), value)
                    if isinstance(value := getattr(part, key), int)
                    else self._draws.value(value, f"{field}.{key}", nodes)
                    for key in PARAMETERS.get(part.kind, ())
                }
            if not isinstance(part, Nothing):
                self._add(number, part.kind, nodes, values)

    def _wrong(self, nodes: Index, field: str) -> Array:
        """Return a candidate of each node that is not its truth, with equal probabilities; the truth if it is the only
        one.

        Call it after `_model` of the same nodes.
        """
        of, listed = self._lists[-1]
        if of is not nodes:
            raise HedgerowError("the candidates of these nodes are not drawn yet", code=Code.CRASH)
        a = self._a[nodes]
        wrong = ~np.isnan(listed) & (listed != a)
        count = wrong.sum(axis=0)
        pick = (self._draws.of(field, nodes)[:, 0] * count).astype(np.int64)
        place = (wrong & (wrong.cumsum(axis=0) == pick + 1)).argmax(axis=0)
        return np.where(count > 0, listed[place, np.arange(len(nodes))], a)

    def _samples(self, part: Samples, nodes: Index) -> Array:
        steps = self._topology.steps
        if part.values is not None:
            return np.repeat(np.array(part.values[:steps])[None], len(nodes), axis=0)
        assert part.file is not None
        if (key := part.reading) not in self._files:
            ids, named = self._topology.ids, self._topology.named_files
            self._files[key] = columns(key.file, self._folder, ids, key.header, key.times, named)
        table = self._files[key]
        return np.array([table[self._topology.ids[k]][:steps] for k in (nodes % self._n).tolist()])

    def _add(self, number: int, kind: str, nodes: Index, values: Mapping[str, NDArray[Any]]) -> None:
        if len(nodes):
            self._groups[number, kind].append(Group(number, kind, nodes, values))


def _joined(groups: Sequence[Group]) -> Group:
    """Join groups of disturbances of the same kind into one."""
    if len(groups) == 1:
        return groups[0]
    nodes = np.concatenate([group.nodes for group in groups])
    order = nodes.argsort()
    values = {key: np.concatenate([group.values[key] for group in groups])[order] for key in groups[0].values}
    return Group(groups[0].number, groups[0].kind, nodes[order], values)


def _jumps(topology: Topology, draws: _Draws) -> tuple[Fault, ...]:
    """Return the faults, with jumps to another candidate than the truth before the jump, if there is one."""
    faults = list(topology.faults)
    now: dict[int | str, Any] = {}
    for at, k in sorted((fault.at, k) for k, fault in enumerate(faults) if isinstance(fault, Jump)):
        jump = cast("Jump", faults[k])
        own = topology.nodes[jump.node]
        candidates = cast("tuple[float, ...]", own.candidates)
        if jump.a == "random":
            others = [a for a in candidates if a != now.get(jump.node, own.a)] or candidates
            pick = draws.at("jump", topology.position(jump.node), at)
            faults[k] = jump = jump.model_copy(update={"a": others[int(pick * len(others))]})
        now[jump.node] = jump.a
    return tuple(faults)


def _worst_case(network: Network, energy: float) -> Network:
    _, direction = smallest_eigenpair(network.a, network.b, network.graph)
    values = np.sqrt(energy) * direction
    nodes = np.flatnonzero(values)
    constant = [Group(0, "constant", nodes, {"value": values[nodes]})] if len(nodes) else []
    return replace(network, disturbance=constant, parts=np.ones(len(values), dtype=np.int64))


def truth(topology: Topology) -> Array:
    """Return the true a of a resolved topology, (n,)."""
    return topology.network.a


def to_yaml(topology: Topology) -> str:
    """Return a topology as YAML text that `hedgerow.topologies.load` reads back to the same bits.

    Raises UserError for a large network: its numbers lie in a table, which no text holds. `save` writes both.
    """
    if isinstance(topology.nodes, Nodes):
        raise UserError(
            f"{topology.name}: {len(topology.ids):,} nodes lie in a table, and not in one text. Write two files with"
            " hedgerow.topologies.resolve.save.",
            code=Code.TOPOLOGY,
        )
    return text_beside_table(topology)


def text_beside_table(topology: Topology, spelled_out: bool = False) -> str:
    """Return the YAML text of a topology; that of a large network refers to its table, `table.NAME`.

    With `spelled_out`, the text has the nodes and edges at any size, and needs no table.
    """
    written = topology.model_dump(mode="json", exclude_none=True, exclude_defaults=True, exclude={"nodes", "edges"})
    if isinstance(topology.nodes, Nodes) and not spelled_out:
        written["table"] = table.NAME
        written.pop("layout", None)
    else:
        nodes = {node: own.model_dump(mode="json", exclude_none=True) for node, own in topology.nodes.items()}
        edges = [Line(edge.model_dump()) if isinstance(edge, Edge) else list(edge) for edge in topology.edges]
        written |= {"nodes": nodes, "edges": edges}
    if "layout" in written:
        written["layout"] = Line(written["layout"])
    whole = {key: written[key] for key in type(topology).model_fields if key in written}
    if topology.faults:
        whole["faults"] = [_lines(fault.written()) for fault in topology.faults]
    return yaml.dump(whole, Dumper=Dumper, sort_keys=False, default_flow_style=None, width=10**6)


def save(topology: Topology, path: Path) -> None:
    """Write a resolved topology to the file `path`; for a large network, write the table beside it."""
    if isinstance(topology.nodes, Nodes):
        table.write(topology.network, path.with_name(table.NAME), topology.layout)
    path.write_text(text_beside_table(topology), encoding="utf-8")


def digest(topology: Topology) -> str:
    """Return a hash of the text of a topology, and of the numbers in its table."""
    found = hashlib.sha256(text_beside_table(topology).encode())
    if isinstance(topology.nodes, Nodes):
        for name, array in sorted(table.arrays(topology.network, topology.layout).items()):
            found.update(f"{name} {array.dtype} {array.shape}".encode())
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


@dataclass(frozen=True)
class Line:
    """A value on one line of the file."""

    value: Any


def _lines(fault: dict[str, Any]) -> Line | dict[str, Any]:
    """Return a line for a fault, or one for each step of its table."""
    if isinstance(table := fault.get("at"), dict):
        return {**fault, "at": {step: Line(struck) for step, struck in table.items()}}
    return Line(fault)


class Dumper(yaml.CSafeDumper):
    """A dumper without aliases that writes floats in the form of YAML 1.1."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _float(dumper: yaml.CSafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _line(dumper: yaml.CSafeDumper, line: Line) -> yaml.Node:
    node = cast("yaml.CollectionNode", dumper.represent_data(line.value))
    node.flow_style = True
    return node


Dumper.add_representer(float, _float)
Dumper.add_representer(Line, _line)
# YAML 1.1 reads `1e5` and `08` as text and writes them without quotes; our reader takes them as numbers.
Dumper.add_implicit_resolver("tag:yaml.org,2002:int", OTHER_WHOLE, list("-+0123456789"))
Dumper.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
