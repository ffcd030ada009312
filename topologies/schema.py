"""The models of a topology file.

One set of models serves the file as written, which may have random numbers and defaults, and the resolved file, which
has every number and every node. `hedgerow.topologies.resolve` makes the second from the first. All models are frozen
and refuse unknown keys. The JSON Schema and docs/topology.md are generated from them.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import (
    AliasChoices,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    StrictBool,
    StrictInt,
    Tag,
    WithJsonSchema,
)
from pydantic_core import PydanticCustomError

from hedgerow.topologies import law_files
from hedgerow.topologies.base import (
    Model,
    Name,
    NodeId,
    Positive,
    Seed,
    Steps,
    number,
)
from hedgerow.topologies.disturbances import (
    Disturbance,
    WorstCase,
    bare_kind,
)
from hedgerow.topologies.edges import Edge, Ends, WrittenEdge, ends_of, weight_of, weights_of
from hedgerow.topologies.faults import Fault
from hedgerow.topologies.generators import GraphRule
from hedgerow.topologies.graph import Gain, Graph, Index
from hedgerow.topologies.law_choice import NAMES, LawChoice
from hedgerow.topologies.network import Network, gains, groups_of, labels, padded, positions
from hedgerow.topologies.partition import parts_of
from hedgerow.topologies.record import Record
from hedgerow.topologies.settings import Defaults, Node, Settings
from hedgerow.topologies.table import NodesBy, Table

LAWS = ("minimax", "hinf", "nominal")
"""the laws of the paper"""
_PATH = r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*"


def _law(value: Any) -> Any:
    """Return the text of a LawChoice for a text, or for a mapping with `name` or `class` and parameters."""
    try:
        if isinstance(value, dict):
            names = [value[key] for key in ("name", "class") if key in value]
            if len(names) != 1 or not isinstance(names[0], str):
                raise ValueError("has either `name:` or `class:`, a text")
            rest = {key: one for key, one in value.items() if key not in ("name", "class")}
            choice = LawChoice.of(names[0], rest)
        elif isinstance(value, str):
            choice = LawChoice.parse(value)
        else:
            raise ValueError("is neither the name of a law nor a mapping with `name:` or `class:`")
    except ValueError as error:
        raise PydanticCustomError("law", "{problem}", {"problem": str(error)}) from None
    if ":" not in choice.name and choice.name not in NAMES:
        near = difflib.get_close_matches(choice.name, NAMES, 1)
        listed = f"; did you mean {near[0]}?" if near else ""
        hint = law_files.hint(choice.name, exact=True) or listed or law_files.hint(choice.name)
        raise PydanticCustomError(
            "law", "a law is {names} or package.module:Class{hint}", {"names": ", ".join(NAMES), "hint": hint}
        )
    if choice.name in LAWS and choice.parameters:
        raise PydanticCustomError("law", "{name} has no parameters", {"name": choice.name})
    return str(choice)


def _nodes(value: Any) -> Any:
    """Return a list of ids as a mapping without settings; `2:` alone is `2: {}`."""
    if isinstance(value, list | tuple):
        return {node: {} for node in value if isinstance(node, int | str)}
    if isinstance(value, dict):
        return {node: {} if settings is None else settings for node, settings in value.items()}
    raise PydanticCustomError("nodes", "expects a list of node ids, or a mapping from ids to their settings")


def _process_count(value: Any) -> Any:
    if isinstance(value, str) and value not in PROCESSES:
        raise PydanticCustomError(
            "processes", "is neither a number nor one of {words}", {"words": " and ".join(PROCESSES)}
        )
    return value


PROCESSES = ("auto", "per-node")
PER_NODE = 64
"""Up to this number of nodes, each node has its own process by default."""
Processes = Annotated[
    Annotated[Annotated[StrictInt, Field(ge=1, lt=2**31)], Tag("number")]
    | Annotated[Literal["auto", "per-node"], Tag("word")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "number"),
    BeforeValidator(_process_count),
]
_FIELD = r"a|b|x0|candidates|disturbance\.[0-9]{1,3}\.[a-z]+"
Lot = Annotated[float, Field(ge=0, lt=1), BeforeValidator(number)]


def _one_lot(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


class GivenLots(Model):
    """Lots in the file, which replace the draws of one seed; other seeds draw all of theirs."""

    seed: Seed = Field(description="the seed of the draws that they replace")
    nodes: dict[
        NodeId,
        dict[
            Annotated[str, Field(pattern=f"^({_FIELD})$")],
            Annotated[tuple[Lot, ...], BeforeValidator(_one_lot, json_schema_input_type=Lot | tuple[Lot, ...])],
        ],
    ] = Field(description="by node and field: a number in [0, 1), of `candidates` a list of them")


_ASIDE = {"name", "law", "faults", "backfill", "history", "processes", "layout", "secure", "record"}
"""The keys of a topology that do not affect its columns."""


class Topology(Model):
    """A network: its nodes, edges, law and disturbances, and the number of steps."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": [key]} for key in ("nodes", "graph", "table")]})

    name: Name = Field(description="the name of the run")
    b: Positive = Field(description="the input gain b of (1), of every node without its own `b`")
    steps: Steps = Field(description="T: inputs act at t = 0 .. T-1, states are recorded at t = 0 .. T")
    seed: Seed = Field(0, description="the seed of all random values")
    lots: GivenLots | None = Field(None, description="earlier lots, which preserve a network when the draws change")
    law: Annotated[
        str,
        BeforeValidator(_law),
        WithJsonSchema(
            {
                "anyOf": [
                    {"type": "string", "pattern": rf"^({'|'.join(NAMES)}|{_PATH})(\(.*\))?$"},
                    {"type": "object", "required": ["name"], "properties": {"name": {"enum": [*NAMES]}}},
                    {
                        "type": "object",
                        "required": ["class"],
                        "properties": {"class": {"type": "string", "pattern": f"^{_PATH}$"}},
                    },
                ]
            }
        ),
    ] = Field(
        "minimax",
        description="minimax (6)-(7), hinf (8), nominal, another name that `orchestrator laws` lists, or"
        " package.module:Class; with parameters as"
        " `{name: …, key: value}` or `{class: …, key: value}`",
    )
    defaults: Defaults = Field(Defaults(), description="the settings of every node without its own value")
    nodes: Annotated[
        dict[NodeId, Node],
        Field(min_length=1),
        # JSON has text as keys, also for whole numbers.
        BeforeValidator(_nodes, json_schema_input_type=list[NodeId] | dict[str, Node | None]),
    ] = Field({}, description="ids, or a mapping from ids to their own settings")
    edges: tuple[WrittenEdge, ...] = Field(
        (), description="undirected pairs of node ids, each once; or `{ends: [1, 2], weight: 0.5}`"
    )
    generator: GraphRule | None = Field(
        None,
        validation_alias=AliasChoices("graph", "generator"),
        serialization_alias="graph",
        description="a rule that makes nodes and edges, in place of `edges:`; `nodes:` may then override some",
    )
    table: str | None = Field(
        None, description="a .npz file beside the topology with edges and more, in place of `edges:`"
    )
    table_nodes: NodesBy | None = Field(
        None, description="the way the table names nodes: `positions` or `ids`; for ambiguous tables"
    )
    disturbance: (
        Annotated[WorstCase, BeforeValidator(bare_kind, json_schema_input_type=WorstCase | Literal["worst_case"])]
        | None
    ) = Field(
        None,
        description="`worst_case`: one disturbance for the whole network, in place of those of the nodes",
    )
    faults: tuple[Fault, ...] = Field((), description="the faults, and their steps")
    backfill: StrictBool = Field(True, description="fetch missing neighbour inputs when the link is up again")
    history: Steps = Field(100_000, description="the number of past steps stored for back-filling")
    secure: StrictBool = Field(
        False,
        description="over Zenoh, every process shows a certificate, and can exchange only its own messages",
    )
    processes: Processes | None = Field(
        None,
        description="agent processes that share the nodes; or `per-node`; or `auto`, one per core. "
        "If absent, `per-node` up to 64 nodes and `auto` beyond",
    )
    layout: tuple[Annotated[StrictInt, Field(ge=0, lt=2**31)], ...] | None = Field(
        None,
        description="the process of each node, from 0, in the order of `nodes:`; a resolved file has it if a fault"
        " names a process",
    )
    record: Record = Field(Record(), description="the part of a large run that is recorded")
    _table: Table | None = PrivateAttr(None)
    """the content of the file of `table:`"""
    _named: frozenset[str] = PrivateAttr(frozenset())
    """files of samples that may be outside the topology's folder"""

    def __repr__(self) -> str:
        size = f"{len(self.nodes)} nodes, {len(self.edges)} edges, {self.steps} steps"
        return f"<Topology {self.name}: {size}, law {self.law}, seed {self.seed}, {len(self.faults)} faults>"

    __str__ = __repr__  # pydantic's text has every node

    @cached_property
    def origin_of_law(self) -> str:
        """Return the place of the law, as the start of a message: `topo.yaml:7: `; empty if it has none."""
        return ""

    @cached_property
    def ids(self) -> Sequence[int | str]:
        """Return node ids in the order of the file, which is the order of every array."""
        if self.generator is not None:
            return range(self.generator.nodes)
        return tuple(self.nodes) if self._table is None else self._table.ids

    @cached_property
    def graph(self) -> Graph:
        """Return the graph over positions in `ids`; raise KeyError for an edge to an unknown node (checked on
        loading).
        """
        if self.generator is not None:
            edges = self.generator.edges(self.seed)
            return Graph(self.generator.nodes, edges, self.generator.weights(self.seed, edges))
        if self._table is not None:
            return Graph(len(self._table.ids), self._table.edges, self._table.weights)
        pairs = [(self.position(i), self.position(j)) for i, j in self.pairs]
        edges = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        written = [weight_of(edge) for edge in self.edges] if self._weighted else 1.0
        return Graph(len(self.ids), edges, weights_of(written, self.seed, self.ids, edges))

    @property
    def pairs(self) -> Sequence[Ends]:
        """Return the ends of every edge of the file, in its order."""
        if not isinstance(self.edges, tuple):
            return cast("Sequence[Ends]", self.edges.pairs)  # topologies.nodes.Edges, for a network in columns
        return [ends_of(edge) for edge in self.edges] if self._weighted else cast("Sequence[Ends]", self.edges)

    @property
    def _weighted(self) -> bool:
        return any(isinstance(edge, Edge) for edge in self.edges)

    @cached_property
    def _places(self) -> dict[int | str, int]:
        return {node: k for k, node in enumerate(self.ids)}

    def position(self, node: int | str) -> int:
        """Return the position of a node in `ids`; raise KeyError if it does not exist."""
        if not isinstance(self.ids, range):
            return self._places[node]
        if not isinstance(node, int) or node not in self.ids:
            raise KeyError(node)
        return self.ids.index(node)

    def has(self, node: object) -> bool:
        """Return True if the node exists."""
        if isinstance(self.ids, range):
            return isinstance(node, int) and node in self.ids
        return node in self._places

    @property
    def process_count(self) -> int:
        """Return the number of agent processes."""
        n = len(self.ids)
        if isinstance(self.processes, int):
            return self.processes
        if self.processes == "per-node" or (self.processes is None and n <= PER_NODE):
            return n
        return min(n, os.cpu_count() or 1)

    @property
    def parts(self) -> tuple[Index, ...]:
        """The positions of nodes by process, ascending: the recorded layout, or a partition of the graph."""
        return parts_of(self.graph, self.process_count, self.layout)

    @property
    def is_drawn(self) -> bool:
        """Return True if all numbers of the network are drawn."""
        return "network" in self.__dict__

    @cached_property
    def network(self) -> Network:
        """Return a resolved topology in columns."""
        own = self.nodes.values()
        a, x0, nominal = np.array([(node.a, node.x0, node.nominal) for node in own], dtype=float).T.copy()
        return Network(
            ids=self.ids,
            graph=self.graph,
            b=self._gain,
            a=a,
            x0=x0,
            nominal=nominal,
            candidates=padded([cast("tuple[float, ...]", node.candidates) for node in own]),
            disturbance=groups_of((_components(node.disturbance) for node in own), self.steps),
            parts=np.array([len(_components(node.disturbance)) for node in own], dtype=np.int64),
            labels=labels([node.label for node in own]),
            positions=positions([node.position for node in own]),
        )

    @property
    def _gain(self) -> Gain:
        """Return the gains of a resolved topology."""
        given = [cast("float | None", node.b) for node in self.nodes.values()]
        return self.b if all(b is None for b in given) else gains([self.b if b is None else b for b in given])

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, without validation; cached results of the old values are dropped."""
        copy = super().model_copy(update=update, deep=deep)
        if not set(update or ()) <= _ASIDE:
            for name in ("ids", "graph", "network", "_places"):
                copy.__dict__.pop(name, None)
        if update:
            copy.__dict__.pop("given_as", None)
        return copy

    @cached_property
    def given_as(self) -> object:
        """Return the text that the numbers were drawn from, as `named.Given`; None for a changed copy."""
        return None

    def with_given(self, given: object) -> Self:
        """Return the same network, which remembers the text that its numbers were drawn from."""
        self.__dict__["given_as"] = given  # not a private attribute: equal networks of two texts are equal
        return self

    @property
    def given(self) -> Table | None:
        """Return the content of the file of `table:`, None if there is none."""
        return self._table

    @property
    def named_files(self) -> frozenset[str]:
        """Return the files of samples that an option or Python names: they may be outside the topology's folder."""
        return self._named

    def naming(self, files: Iterable[str]) -> Self:
        """Return a copy that may read these files of samples anywhere."""
        copy = self.model_copy()
        copy._named = frozenset(files)
        return copy

    def with_table(self, table: Table) -> Self:
        """Return a copy with the content of the file of `table:`."""
        # `layout: null` replaces the layout in the table: with another number of processes it would not fit.
        layout = self.layout if "layout" in self.model_fields_set else table.layout
        copy = self.model_copy(update={"table": self.table, "layout": layout})
        copy._table = table
        return copy

    def with_origin_of_law(self, origin: str) -> Self:
        """Return a copy with the place of its law."""
        self.__dict__["origin_of_law"] = origin  # not a private attribute: equal files in two places are equal
        return self

    def of_network(self, network: Network) -> Self:
        """Return a copy that is resolved to this network."""
        # Equal gains are stored in the network: its file lists them once.
        copy = self.model_copy(update={"b": network.b} if isinstance(network.b, float) else None)
        copy._table = None
        copy.__dict__.update(ids=network.ids, graph=network.graph, network=network)
        return copy

    def settings(self, node: int | str) -> Node:
        """Return the settings of `node`: its own, then the numbers of the table, the defaults and the built-in ones."""
        own = self.nodes.get(node, Node())
        if self._table is not None and self.has(node):
            numbers = self._table.numbers(self.position(node))
            own = own.model_copy(update={key: value for key, value in numbers.items() if getattr(own, key) is None})
        return self.behind(own)

    def behind(self, own: Node) -> Node:
        """Return these settings, with gaps filled by the defaults."""
        layers = (own, self.defaults, Defaults.FALLBACK)
        merged = {
            key: next((value for layer in layers if (value := getattr(layer, key)) is not None), None)
            for key in Settings.model_fields
        }
        if merged["b"] is None:
            merged["b"] = self.b
        return Node.model_construct(**merged, label=own.label, position=own.position)


def _components(disturbance: Disturbance | None) -> list[dict[str, Any]]:
    """Return the disturbances of a node that are summed, as a file spells them."""
    parts = disturbance if isinstance(disturbance, tuple) else (disturbance,)
    return [part.model_dump() for part in parts if part is not None]
