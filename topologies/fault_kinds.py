"""The kinds of faults: the keys of each kind, and its effects. Without pydantic: the plant uses this table too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.topologies.graph import Graph, Index, Mask

NodeId = int | str
Pair = tuple[NodeId, NodeId]
Values = Mapping[str, Any]
"""the values of a valid fault by key; the sender of messages is `from_`, as in Python; absent keys may be None"""


class FaultKind(NamedTuple):
    """The keys and the effects of one kind of fault."""

    forms: tuple[tuple[str, ...], ...]
    """the alternative sets of keys that name the target; exactly one set is given"""
    effects: Callable[[str, Values, int, Places], list[Effect]]
    """the effects of the values of a fault; its arguments are the kind, the values, the fault's number and places"""
    required: tuple[str, ...] = ()
    """other keys that are always given"""
    optional: tuple[str, ...] = ()
    """other keys that may be given"""


class Places:
    """The positions, in the arrays of a run, of the nodes, links and edges that faults name."""

    def __init__(self, graph: Graph, position: Callable[[NodeId], int], parts: Callable[[], Sequence[Index]]) -> None:
        """`position` returns the position of a node, or raises KeyError; `parts` returns the nodes of each process."""
        self.graph = graph
        self._position, self._parts = position, parts
        self._incidence = graph.node * graph.n + graph.neighbour  # ascending, as they are ordered

    def nodes(self, ids: Iterable[NodeId]) -> tuple[int, ...]:
        """Return the positions of `ids`, in their order."""
        return tuple(self._position(node) for node in ids)

    def links(self, pairs: Iterable[Pair]) -> tuple[int, ...]:
        """Return, per pair (from, to), the incidence where `to` receives from `from`; each once, ascending.

        Raise KeyError for a pair that is not connected.
        """
        keys = np.unique([self._position(to) * self.graph.n + self._position(sender) for sender, to in pairs])
        found = np.searchsorted(self._incidence, keys)
        last = len(self._incidence) - 1
        if len(keys) and (last < 0 or not (self._incidence[np.minimum(found, last)] == keys).all()):
            raise KeyError("a link that does not exist")
        return _plain(found)

    def edges(self, pairs: Iterable[Pair]) -> tuple[int, ...]:
        """Return the edges between the nodes of each pair; each once, ascending."""
        return _plain(np.unique(self.graph.edge[list(self.links(pairs))]))

    def apart(self, groups: Sequence[Sequence[NodeId]]) -> Mask:
        """Return a mask of the incidences with ends in different groups."""
        group = np.full(self.graph.n, -1)
        for k, members in enumerate(groups):
            group[list(self.nodes(members))] = k
        one, other = group[self.graph.node], group[self.graph.neighbour]
        apart: Mask = (one != other) & (one >= 0) & (other >= 0)
        return apart

    def process(self, number: int) -> tuple[int, ...]:
        """Return the nodes of a process."""
        return _plain(self._parts()[number])


def _lasting(kind: str, values: Values, fault: int, targets: tuple[int, ...], by: int = 0) -> list[Effect]:
    start, stop = values.get("steps") or (0, FOREVER)
    return [Effect(fault, kind, targets, start, stop, values.get("probability", 1.0), by=by)]


def _by_step(
    kind: str, values: Values, fault: int, places: Callable[[Iterable[Pair]], tuple[int, ...]]
) -> list[Effect]:
    table = {step: places(pairs) for step, pairs in sorted(values["at"].items())}
    return [Effect(fault, kind, (), min(table), max(table) + 1, table=table)]


def _links(kind: str, values: Values, fault: int, places: Places) -> list[Effect]:
    if values.get("at") is not None:
        return _by_step(kind, values, fault, places.links)
    link = values.get("link")
    pairs = [(values["from_"], values["to"])] if link is None else [link, link[::-1]]
    return _lasting(kind, values, fault, places.links(pairs), values.get("by", 0))


def _edges(kind: str, values: Values, fault: int, places: Places) -> list[Effect]:
    if values.get("at") is not None:
        return _by_step(kind, values, fault, places.edges)
    return _lasting(kind, values, fault, places.edges([values["edge"]]))


def _partition(_: str, values: Values, fault: int, places: Places) -> list[Effect]:
    apart = places.apart(values["groups"])
    found = _lasting("drop", values, fault, _plain(np.flatnonzero(apart)))
    if values.get("cut"):
        found += _lasting("cut", values, fault, _plain(np.unique(places.graph.edge[apart])))
    return found


def _node(kind: str, values: Values, fault: int, places: Places) -> list[Effect]:
    return _lasting(kind, values, fault, places.nodes([values["node"]]))


def _crash(kind: str, values: Values, fault: int, places: Places) -> list[Effect]:
    process, at, misses = values.get("process"), values["at"], values.get("restart_after")
    nodes = places.nodes([values["node"]]) if process is None else places.process(process)
    return [Effect(fault, kind, nodes, at, FOREVER if misses is None else min(at + misses, FOREVER))]


def _jump(kind: str, values: Values, fault: int, places: Places) -> list[Effect]:
    assert isinstance(values["a"], float), "resolving draws it"
    return [Effect(fault, kind, places.nodes([values["node"]]), values["at"], FOREVER, a=values["a"])]


_OFTEN = ("steps", "probability")
FAULT_KINDS: Mapping[str, FaultKind] = {
    "drop": FaultKind((("link",), ("from", "to"), ("at",)), _links, optional=_OFTEN),
    "delay": FaultKind((("link",), ("from", "to")), _links, required=("by",), optional=_OFTEN),
    "cut": FaultKind((("edge",), ("at",)), _edges, optional=_OFTEN),
    "partition": FaultKind((("groups",),), _partition, optional=("steps", "cut")),
    "sensor": FaultKind((("node",),), _node, optional=_OFTEN),
    "actuator": FaultKind((("node",),), _node, optional=_OFTEN),
    "crash": FaultKind((("node",), ("process",)), _crash, required=("at",), optional=("restart_after",)),
    "jump": FaultKind((("node",),), _jump, required=("at", "a")),
}


def _plain(found: Index) -> tuple[int, ...]:
    return tuple(found.tolist())
