"""A graph as a reader finds it, before it becomes undirected and simple."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Array, Index

Value = float | str | None


def refuse(place: object, problem: str, fix: str = "", code: Code = Code.FILE_FORMAT) -> UserError:
    """Return the error for input that cannot be imported, for the caller to raise."""
    return UserError(f"{place}: {problem}." + (f" {fix}." if fix else ""), code=code)


@dataclass(eq=False)
class Found:
    """Nodes and edges of a source, with their attributes; loops and repeated edges included."""

    source: str
    """the file or object, for messages"""
    names: Sequence[Hashable]
    """the names of the nodes, each once"""
    edges: Index
    """positions in `names`, (E, 2)"""
    directed: bool = False
    """True if an edge from i to j may have a second one from j to i"""
    labels: Sequence[str | None] | None = None
    positions: Array | None = None
    """(n, 2), y upwards; NaN where a node has none"""
    weights: Array | None = None
    """(E,); None if the source gives none"""
    storage: Array | None = None
    """c_i of each node, above 0, (n,); None if all have 1"""
    a: float | None = None
    """the true a of every node, if the source gives it"""
    b: float | None = None
    """the gain, if the source gives its unit"""
    samples: Array | None = None
    """w_i(t), (n, T)"""
    steps: int | None = None
    edge_names: Sequence[str] | None = None
    """the names of edges in messages, (E,)"""
    sign: Callable[[float], str] = field(default=lambda _: "")
    """the meaning in the source of a weight that is not above 0"""
    facts: list[str] = field(default_factory=list)
    """sentences about the meaning of the numbers in the source"""
    assumptions: list[str] = field(default_factory=list)
    """sentences about values that the source does not give"""
    changes: list[str] = field(default_factory=list)
    """sentences about merged and dropped parts"""

    def edge_name(self, k: int) -> str:
        """Return the name of edge k for a message."""
        i, j = self.edges[k].tolist()
        ends = f"edge {self.names[i]} - {self.names[j]}"
        return ends if self.edge_names is None else f"{self.edge_names[k]} ({ends})"

    def place(self, k: int) -> str:
        """Return the file and the name of edge k, as the start of a message."""
        name = self.edge_name(k)
        return name if name.startswith(f"{self.source}:") else f"{self.source}: {name}"


def numbers(
    source: str, what: str, name: str, values: Sequence[Any], named: Callable[[int], str], missing: float = np.nan
) -> Array:
    """Return the values of an attribute as numbers; raise UserError for text, and for a missing value.

    `missing` replaces a value None, if it is a number.
    """
    found = np.empty(len(values))
    for k, value in enumerate(values):
        if value is None and not np.isnan(missing):
            found[k] = missing
            continue
        try:
            if value is None or isinstance(value, bool) or (isinstance(value, str) and as_number(value) is None):
                raise ValueError
            found[k] = float(value)
        except (TypeError, ValueError):
            shown = "is missing (empty or NaN)" if value is None else f"{str(value)[:40]!r} is not a number"
            cure = "Give it a number or remove it, or name an attribute that all of them have"
            if isinstance(value, str) and as_number(value.replace(",", ".", 1)) is not None:
                cure = "Write decimals with a point"
            # The place of an edge in a file begins with the file already.
            place = named(k) if named(k).startswith(f"{source}:") else f"{source}: {named(k)}"
            raise refuse(place, f"{what} attribute `{name}` {shown}", cure) from None
    return found


def weights_of(
    source: str, asked: str | None, attributes: Sequence[Mapping[str, Any]], named: Callable[[int], str]
) -> tuple[Array | None, str]:
    """Return the weights of edges, (E,) or None for all ones, and a sentence about their source.

    asked: the attribute that the user names, or a number for all edges; None takes `weight` if every edge has it.
    """
    keys: dict[str, int] = {}
    for own in attributes:
        for key, value in own.items():
            if isinstance(value, int | float | np.number) and not isinstance(value, bool):
                keys[key] = keys.get(key, 0) + 1
    if asked is not None and (number := as_number(asked)) is not None:
        return np.full(len(attributes), number), f"Every edge has the weight {number:g}, by the option"
    if asked is not None:
        if not any(asked in own for own in attributes):
            known = ", ".join(sorted(map(str, keys))) or "none that are numbers"
            raise refuse(
                f"--weight {asked}", "no edge has this attribute", f"The attributes of edges are: {known}", Code.OPTION
            )
        return numbers(source, "the", asked, [own.get(asked) for own in attributes], named), (
            f"The weights are the attribute `{asked}` of the edges"
        )
    # Gephi writes `Weight`.
    spelled = next((key for key in ("weight", "Weight") if any(own.get(key) is not None for own in attributes)), None)
    if spelled is not None:
        return numbers(source, "the", spelled, [own.get(spelled) for own in attributes], named), (
            f"The weights are the attribute `{spelled}` of the edges"
        )
    whole = sorted(str(key) for key, count in keys.items() if count == len(attributes))
    hint = f"; --weight can take {', '.join(whole)}" if whole else ""
    return None, f"Every edge has the weight 1{hint}"


def storage_of(
    source: str, asked: str | float | None, attributes: Sequence[Mapping[str, Any]], others: float | None, noun: str
) -> tuple[Array | None, str | None]:
    """Return the storage of nodes, (n,) or None for 1 everywhere, and a sentence about its source.

    asked: an attribute of nodes, or a number for all of them; others: the storage of nodes without the attribute.
    """
    if asked is None:
        return None, None
    if (number := as_number(asked)) is not None:
        return np.full(len(attributes), number), f"Every {noun} has the storage {number:g}, by the option"
    key = str(asked)
    if not any(key in own for own in attributes):
        known = ", ".join(sorted({str(key) for own in attributes for key in own})) or "none"
        raise refuse(f"--storage {asked}", f"no {noun} has this attribute", f"The attributes are: {known}", Code.OPTION)
    values = numbers(
        source, "the", key, [own.get(key) for own in attributes], lambda k: f"{noun} number {k + 1}", missing=0.0
    )
    without = ~(values > 0)
    if without.any():
        if others is None:
            raise refuse(
                f"--storage {asked}",
                f"{int(without.sum())} of {len(values)} {noun}s have no value above 0",
                "Give those a storage with --junction-storage",
                Code.OPTION,
            )
        values[without] = others
        return values, (
            f"The storage of a {noun} is its attribute `{key}`; "
            f"{int(without.sum())} without one have {others:g}, by the option"
        )
    return values, f"The storage of a {noun} is its attribute `{key}`"


def as_number(value: str | float) -> float | None:
    """Return a word of the command line as a number, or None if it is a name."""
    if isinstance(value, str) and "_" in value:
        return None  # Python reads 1_0 as 10
    try:
        found = float(value)
    except ValueError:
        return None
    return found


def pairs(found: Sequence[tuple[int, int]]) -> Index:
    """Return pairs of positions as an array, (E, 2)."""
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def places(found: Sequence[tuple[float, float] | None]) -> Array | None:
    """Return the positions of nodes, (n, 2), NaN for a node without one; None if no node has one.

    Some tools write (0, 0) for every node if they have no positions: several nodes in one place have none.
    """
    given = {place for place in found if place is not None}
    if not given or (len(given) == 1 < sum(place is not None for place in found)):
        return None
    array: NDArray[np.float64] = np.array([(np.nan, np.nan) if one is None else one for one in found], dtype=float)
    return array
