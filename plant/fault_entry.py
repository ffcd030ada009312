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
from hedgerow.topologies.fault_kinds import FAULT_KINDS, NodeId, Pair, Places
from hedgerow.topologies.graph import Array, Graph, Index

Entry = Mapping[str, Any]
MOST_LATE = 10**6


class FaultEntries:
    """The reader of fault entries for one network."""

    def __init__(
        self, graph: Graph, ids: Sequence[NodeId] | NDArray[Any], shards: Sequence[Index], candidates: Array | None
    ) -> None:
        """`candidates` are the values that a jump may give a node, (M, n), padded with NaN; None allows any number."""
        self._graph, self._ids, self._shards, self._candidates = graph, ids, shards, candidates
        self._checks: Mapping[str, Callable[[Entry, str], Any]] = {
            "link": lambda entry, key: self._pair(key, entry[key]),
            "edge": lambda entry, key: self._pair(key, entry[key]),
            "from": lambda entry, key: self._node(key, entry[key]),
            "to": lambda entry, key: self._pair(key, [entry["from"], entry[key]])[1],
            "node": lambda entry, key: self._node(key, entry[key]),
            "groups": lambda entry, key: self._groups(entry[key]),
            "at": self._steps,
            "a": self._candidate,
            "cut": _boolean,
            "steps": _window,
            "by": lambda entry, key: integer(entry, key, 1, MOST_LATE),
            "process": lambda entry, key: integer(entry, key, 0, len(shards) - 1),
            "probability": lambda entry, key: number(entry, key, 0, 1),
            "restart_after": lambda entry, key: integer(entry, key, 1, FOREVER),
        }
        """by key, which means the same in every kind: the function that returns its valid value, or raises UserError"""

    def effects(self, entry: Entry, fault: int) -> list[Effect]:
        """Return the effects of an entry that counts the steps of the run; `fault` is its number in the list.

        Raise UserError for an entry that no resolved file of this network may contain.
        """
        name = entry.get("kind")
        if not isinstance(name, str) or name not in FAULT_KINDS:
            raise _refused("kind", f"{shortened(name)} is none of {', '.join(FAULT_KINDS)}")
        kind, given = FAULT_KINDS[name], entry.keys() - {"kind"}
        targets = {key for form in kind.forms for key in form}
        if strange := sorted(given - targets - {*kind.required, *kind.optional}):
            raise _refused("entry", f"{shortened(strange[0])} is no key of a {name}")
        form = next((form for form in kind.forms if {*form} == given & targets), None)
        if form is None:
            forms = ", or ".join(" with ".join(form) for form in kind.forms)
            raise _refused("entry", f"a {name} has exactly one of {forms}")
        if form == ("at",) and given - {"at"}:
            raise _refused("at", "is the only key of a table of steps")
        others = [key for key in kind.optional if key in given]
        values = {key: self._checks[key](entry, key) for key in (*form, *kind.required, *others)}
        values["from_"] = values.pop("from", None)
        return kind.effects(name, values, fault, self._places)

    @cached_property
    def _positions(self) -> Mapping[NodeId, int]:
        """The position of each id; most runs never need it."""
        ids = self._ids.tolist() if isinstance(self._ids, np.ndarray) else self._ids
        return {node: k for k, node in enumerate(ids)}

    @cached_property
    def _places(self) -> Places:
        return Places(self._graph, self._positions.__getitem__, lambda: self._shards)

    def _node(self, key: str, node: Any) -> NodeId:
        if type(node) not in (int, str) or node not in self._positions:
            raise _refused(key, f"{shortened(node)} is no node")
        known: NodeId = node
        return known

    def _pair(self, key: str, pair: object) -> Pair:
        if not isinstance(pair, list) or len(pair) != 2:
            raise _refused(key, f"{shortened(pair)} is no pair of nodes")
        ends = self._node(key, pair[0]), self._node(key, pair[1])
        try:
            self._places.links([ends])
        except KeyError:
            raise _refused(key, f"nodes {ends[0]} and {ends[1]} are not neighbours") from None
        return ends

    def _steps(self, entry: Entry, key: str) -> int | dict[int, list[Pair]]:
        """Return the step of a fault, or the pairs by step of a fault that they name."""
        table = entry.get(key)
        if (key,) not in FAULT_KINDS[entry["kind"]].forms:
            return integer(entry, key, 0, FOREVER)
        if not isinstance(table, dict) or not table:
            raise _refused(key, f"{shortened(table)} is no table of pairs by step")
        return {_step(step): [self._pair(key, pair) for pair in _list(key, pairs)] for step, pairs in table.items()}

    def _groups(self, groups: object) -> list[list[NodeId]]:
        listed = _list("groups", groups)
        if len(listed) < 2:
            raise _refused("groups", f"{shortened(groups)} are not two groups or more")
        seen: set[NodeId] = set()
        for members in listed:
            nodes = [self._node("groups", node) for node in _list("groups", members)]
            if not nodes or len({*nodes}) < len(nodes) or not seen.isdisjoint(nodes):
                raise _refused("groups", f"{shortened(members)} is empty, or names a node for a second time")
            seen.update(nodes)
        return listed

    def _candidate(self, entry: Entry, key: str) -> float:
        node, a = self._node("node", entry["node"]), number(entry, key, -1, 1)
        if self._candidates is not None and a not in (own := self._candidates[:, self._positions[node]]):
            listed = ", ".join(map(repr, own[~np.isnan(own)].tolist()))
            raise _refused(key, f"{a!r} is not among the candidates of node {node}: {listed}")
        return a


def _boolean(entry: Entry, key: str) -> bool:
    if not isinstance(value := entry[key], bool):
        raise _refused(key, f"{shortened(value)} is neither true nor false")
    return value


def _window(entry: Entry, key: str) -> tuple[int, int]:
    match entry[key]:
        case [int() as start, int() as stop] if type(start) is type(stop) is int and 0 <= start < stop <= FOREVER:
            return start, stop
    raise _refused(key, f"{shortened(entry[key])} is no window of steps [from, to)")


def _refused(key: str, why: str) -> UserError:
    return UserError(f"{key}: {why}", code=Code.FAULT)


def _list(key: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise _refused(key, f"{shortened(value)} is no list")
    return value


def _step(key: str) -> int:
    if not (key.isascii() and key.isdecimal() and len(key) <= len(str(FOREVER)) and str(int(key)) == key):
        raise _refused("at", f"{shortened(key)} is no step")
    if int(key) > FOREVER:
        raise _refused("at", f"{shortened(key)} is above {FOREVER}")
    return int(key)
