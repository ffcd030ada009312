"""The fault that a command adds to a running plant: checked as a file's, and turned into effects, without pydantic.

Any process that reaches the plant can send a command. The observer writes each added fault into the resolved file, so
the plant accepts exactly what such a file may contain, and computes the effects itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.plant.request import integer, number, shortened
from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array, Graph, Index, Mask

NodeId = int | str
Entry = Mapping[str, Any]
MOST_LATE = 10**6
_FORMS: dict[str, tuple[tuple[str, ...], ...]] = {
    "drop": (("link",), ("from", "to"), ("at",)),
    "delay": (("link",), ("from", "to")),
    "cut": (("edge",), ("at",)),
    "partition": (("groups",),),
    "sensor": (("node",),),
    "actuator": (("node",),),
    "crash": (("node",), ("process",)),
    "jump": (("node",),),
}
"""by kind: the alternative sets of keys that name the target"""
_OTHERS: dict[str, frozenset[str]] = {
    "drop": frozenset(("steps", "probability")),
    "delay": frozenset(("steps", "probability", "by")),
    "cut": frozenset(("steps", "probability")),
    "partition": frozenset(("steps", "cut")),
    "sensor": frozenset(("steps", "probability")),
    "actuator": frozenset(("steps", "probability")),
    "crash": frozenset(("at", "restart_after")),
    "jump": frozenset(("at", "a")),
}
"""by kind: the other keys"""


class FaultEntries:
    """The reader of fault entries for one network."""

    def __init__(
        self, graph: Graph, ids: Sequence[NodeId] | NDArray[Any], shards: Sequence[Index], candidates: Array | None
    ) -> None:
        """`candidates` are the values that a jump may give a node, (M, n), padded with NaN; None allows any number."""
        self._graph, self._ids, self._shards, self._candidates = graph, ids, shards, candidates

    def effects(self, entry: Entry, fault: int) -> list[Effect]:
        """Return the effects of an entry that counts the steps of the run; `fault` is its number in the list.

        Raise UserError for an entry that no resolved file of this network may contain.
        """
        kind = entry.get("kind")
        if not isinstance(kind, str) or kind not in _FORMS:
            raise _refused("kind", f"{shortened(kind)} is none of {', '.join(_FORMS)}")
        given = entry.keys() - {"kind"}
        names = {key for form in _FORMS[kind] for key in form}
        if strange := sorted(given - names - _OTHERS[kind]):
            raise _refused("entry", f"{shortened(strange[0])} is no key of a {kind}")
        if (form := tuple(key for key in entry if key in names)) not in {*_FORMS[kind], ("to", "from")}:
            forms = ", or ".join(" with ".join(form) for form in _FORMS[kind])
            raise _refused("entry", f"a {kind} has exactly one of {forms}")
        if form == ("at",) and given - {"at"}:
            raise _refused("at", "is the only key of a table of steps")
        make: Callable[[Entry, int], list[Effect]] = getattr(self, f"_{kind}")
        return make(entry, fault)

    def _drop(self, entry: Entry, fault: int) -> list[Effect]:
        if "at" in entry:
            return [self._by_step(entry, fault, self._links)]
        return [Effect(fault, "drop", self._link(entry), *_window(entry), _probability(entry))]

    def _delay(self, entry: Entry, fault: int) -> list[Effect]:
        by = integer(entry, "by", 1, MOST_LATE)
        return [Effect(fault, "delay", self._link(entry), *_window(entry), _probability(entry), by=by)]

    def _cut(self, entry: Entry, fault: int) -> list[Effect]:
        if "at" in entry:
            return [self._by_step(entry, fault, self._edges)]
        edges = self._edges("edge", [entry["edge"]])
        return [Effect(fault, "cut", edges, *_window(entry), _probability(entry))]

    def _partition(self, entry: Entry, fault: int) -> list[Effect]:
        cut = entry.get("cut", False)
        if not isinstance(cut, bool):
            raise _refused("cut", f"{shortened(cut)} is neither true nor false")
        apart = self._apart(entry["groups"])
        found = [Effect(fault, "drop", _plain(np.flatnonzero(apart)), *_window(entry))]
        if cut:
            found.append(Effect(fault, "cut", _plain(np.unique(self._graph.edge[apart])), *_window(entry)))
        return found

    def _sensor(self, entry: Entry, fault: int) -> list[Effect]:
        node = self._node("node", entry["node"])
        return [Effect(fault, entry["kind"], (node,), *_window(entry), _probability(entry))]

    _actuator = _sensor

    def _crash(self, entry: Entry, fault: int) -> list[Effect]:
        start, stop = integer(entry, "at", 0, FOREVER), FOREVER
        if "restart_after" in entry:
            stop = min(start + integer(entry, "restart_after", 1, FOREVER), FOREVER)
        if "process" in entry:
            nodes = _plain(self._shards[integer(entry, "process", 0, len(self._shards) - 1)])
        else:
            nodes = (self._node("node", entry["node"]),)
        return [Effect(fault, "crash", nodes, start, stop)]

    def _jump(self, entry: Entry, fault: int) -> list[Effect]:
        node, a = self._node("node", entry["node"]), number(entry, "a", -1, 1)
        if self._candidates is not None and a not in (own := self._candidates[:, node]):
            listed = ", ".join(map(repr, own[~np.isnan(own)].tolist()))
            raise _refused("a", f"{a!r} is not among the candidates of node {entry['node']}: {listed}")
        return [Effect(fault, "jump", (node,), integer(entry, "at", 0, FOREVER), FOREVER, a=a)]

    # The targets.

    @cached_property
    def _places(self) -> Mapping[Any, int]:
        """The position of each id; most runs never need it."""
        ids = self._ids.tolist() if isinstance(self._ids, np.ndarray) else self._ids
        return {node: k for k, node in enumerate(ids)}

    def _node(self, key: str, node: object) -> int:
        if type(node) not in (int, str) or (place := self._places.get(node)) is None:
            raise _refused(key, f"{shortened(node)} is no node")
        return place

    def _pair(self, key: str, pair: object) -> tuple[int, int]:
        if not isinstance(pair, list) or len(pair) != 2:
            raise _refused(key, f"{shortened(pair)} is no pair of nodes")
        return self._node(key, pair[0]), self._node(key, pair[1])

    def _incidence(self, key: str, sender: int, to: int) -> int:
        """Return the position of the link on which `to` receives from `sender`."""
        first, stop = np.searchsorted(self._graph.node, [to, to + 1])
        found = np.flatnonzero(self._graph.neighbour[first:stop] == sender)
        if not len(found):
            raise _refused(key, f"nodes {self._ids[sender]} and {self._ids[to]} are not neighbours")
        return int(first + found[0])

    def _link(self, entry: Entry) -> tuple[int, ...]:
        if "link" in entry:
            i, j = self._pair("link", entry["link"])
            return _once([self._incidence("link", i, j), self._incidence("link", j, i)])
        return (self._incidence("to", self._node("from", entry["from"]), self._node("to", entry["to"])),)

    def _links(self, key: str, pairs: object) -> tuple[int, ...]:
        return _once([self._incidence(key, *self._pair(key, pair)) for pair in _list(key, pairs)])

    def _edges(self, key: str, pairs: object) -> tuple[int, ...]:
        return _once(self._graph.edge[list(self._links(key, pairs))].tolist())

    def _by_step(self, entry: Entry, fault: int, read: Callable[[str, object], tuple[int, ...]]) -> Effect:
        table = entry["at"]
        if not isinstance(table, dict) or not table:
            raise _refused("at", f"{shortened(table)} is no table of pairs by step")
        struck = {_step(key): read("at", pairs) for key, pairs in table.items()}
        return Effect(fault, entry["kind"], (), min(struck), max(struck) + 1, table=dict(sorted(struck.items())))

    def _apart(self, groups: object) -> Mask:
        """Return a mask of the incidences with ends in different groups."""
        listed = _list("groups", groups)
        if len(listed) < 2:
            raise _refused("groups", f"{shortened(groups)} are not two groups or more")
        group = np.full(self._graph.n, -1)
        for k, members in enumerate(listed):
            nodes = [self._node("groups", node) for node in _list("groups", members)]
            if not nodes or len({*nodes}) < len(nodes) or (group[nodes] >= 0).any():
                raise _refused("groups", f"{shortened(members)} is empty, or names a node for a second time")
            group[nodes] = k
        one, other = group[self._graph.node], group[self._graph.neighbour]
        apart: Mask = (one != other) & (one >= 0) & (other >= 0)
        return apart


def _refused(key: str, why: str) -> UserError:
    return UserError(f"{key}: {why}", code=Code.FAULT)


def _list(key: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise _refused(key, f"{shortened(value)} is no list")
    return value


def _window(entry: Entry) -> tuple[int, int]:
    if "steps" not in entry:
        return 0, FOREVER
    match entry["steps"]:
        case [int() as start, int() as stop] if type(start) is type(stop) is int and 0 <= start < stop <= FOREVER:
            return start, stop
    raise _refused("steps", f"{shortened(entry['steps'])} is no window of steps [from, to)")


def _step(key: str) -> int:
    if not (key.isascii() and key.isdecimal() and len(key) <= len(str(FOREVER)) and str(int(key)) == key):
        raise _refused("at", f"{shortened(key)} is no step")
    if int(key) > FOREVER:
        raise _refused("at", f"{shortened(key)} is above {FOREVER}")
    return int(key)


def _probability(entry: Entry) -> float:
    return number(entry, "probability", 0, 1) if "probability" in entry else 1.0


def _once(places: Sequence[int]) -> tuple[int, ...]:
    return tuple(sorted({*places}))


def _plain(places: Index) -> tuple[int, ...]:
    return tuple(places.tolist())
