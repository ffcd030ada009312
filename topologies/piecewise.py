"""Validate a large value in pieces: memory holds only the mistakes of one piece at a time.

pydantic needs about 2 kB for each mistake, and a file of 1 MB can have 500,000.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

PIECE = 5000
"""values in one piece"""
LENGTHS = frozenset(("too_short", "too_long"))
"""types of pydantic's mistakes of a length"""
_BESIDE, _SAMPLE, _LEVELS = 64, 8, 4
"""keys that a piece copies from the mapping around it; members and levels of the value of such a key"""


def errors(model: type[BaseModel], value: Any, piece: int = PIECE) -> Iterator[ErrorDetails]:
    """Yield the mistakes that `model` finds in a large value, with the locations of the whole value.

    A value of one piece yields nothing. Rules about all members of a large collection together are not checked.
    """
    large = _large(value, piece)
    if id(value) in large:
        for part in _parts(value, (), (), large, piece):
            yield from _errors(model, part)


@dataclass(frozen=True)
class _Part:
    """Some members of one collection, inside copies of the collections that lead to it."""

    around: tuple[Any, ...]
    """the collections that lead to the collection, from outside, and that itself"""
    path: tuple[Any, ...]
    members: tuple[Any, ...]
    """keys or indices, in order and without gaps"""
    is_first: bool
    """True if the part also answers for the collection as a whole"""

    def value(self) -> Any:
        *around, inmost = self.around
        built = _with(inmost, {key: inmost[key] for key in self.members})
        for collection, key in zip(reversed(around), reversed(self.path), strict=True):
            built = _with(collection, {key: built})
        return built

    def place(self, value: Any, location: Sequence[int | str]) -> tuple[tuple[int | str, ...], tuple[Any, ...]]:
        """Return a location in `value` as one in the whole, and the path in the file that it leads to."""
        path, _, steps = trace(value, location)
        whole, own = list(location), list(path)
        for depth, at in enumerate(steps[: len(self.path) + 1]):
            if isinstance(self.around[depth], list):
                key = self.path[depth] if depth < len(self.path) else self.members[own[depth]]
                own[depth] = whole[at] = key
            if own[depth : depth + 1] != [*self.path[depth : depth + 1]]:  # the location leads to a neighbouring key
                break
        return tuple(whole), tuple(own)

    def owns(self, path: tuple[Any, ...], details: ErrorDetails) -> bool:
        """Return True if the part is the one that reports a mistake at a path of the whole."""
        depth = len(self.path)
        if path[:depth] != self.path:
            return False
        if len(path) > depth:
            return path[depth] in self._own
        collection, last = self.around[-1], details["loc"][-1]
        there = last in collection if isinstance(collection, dict) else last in range(len(collection))
        return self.is_first and not (details["type"] == "missing" and there)

    @cached_property
    def _own(self) -> frozenset[Any]:
        return frozenset(self.members)


def _errors(model: type[BaseModel], part: _Part) -> Iterator[ErrorDetails]:
    value = part.value()
    try:
        model.model_validate(value)
    except ValidationError as error:
        for details in error.errors(include_url=False, include_input=False):
            location, path = part.place(value, details["loc"])
            if not part.owns(path, details):
                continue
            if details["type"] in LENGTHS:
                at = part.around[-1] if path == part.path else trace(value, details["loc"])[1]
                if is_length(details, at):
                    continue
            details["loc"] = location
            yield details


def trace(value: Any, location: Sequence[int | str]) -> tuple[tuple[Any, ...], Any, list[int]]:
    """Return the path in a file that pydantic's location leads to, its value, and the steps of the path.

    pydantic adds other steps: names of members of unions.
    """
    path: list[Any] = []
    steps: list[int] = []
    for k, step in enumerate(location):
        key = _key(value, step)
        if key is not None:
            path.append(key)
            steps.append(k)
            value = value[key]
        elif k == len(location) - 1 and step == "[key]":
            value = path[-1]
    return tuple(path), value, steps


def _key(value: Any, step: int | str) -> Any:
    """Return the key or the index of `value` that pydantic means by `step`; None if it is neither."""
    if isinstance(value, list):
        return step if isinstance(step, int) and step < len(value) else None
    if not isinstance(value, dict):
        return None
    if step in value:
        return step
    # A key that is a number with a point comes as text.
    return next((key for key in value if type(key) is float and str(key) == step), None)


def is_length(details: ErrorDetails, collection: Any) -> bool:
    """Return True if a mistake of a length is a consequence: pydantic does not count the wrong members."""
    if details["type"] not in LENGTHS or not isinstance(collection, list | dict):
        return False
    bounds = details.get("ctx", {})
    return bool(bounds.get("min_length", 0) <= len(collection) <= bounds.get("max_length", len(collection)))


def _large(value: Any, piece: int) -> set[int]:
    """Return the identities of the collections in `value` that hold more than `piece` values, at all depths."""
    found: set[int] = set()

    def size(inside: Any) -> int:
        members = inside.values() if isinstance(inside, dict) else inside if isinstance(inside, list) else ()
        total = 1 + sum(size(member) if isinstance(member, dict | list) else 1 for member in members)
        if total > piece:
            found.add(id(inside))
        return total

    size(value)
    return found


def _parts(value: Any, around: tuple[Any, ...], path: tuple[Any, ...], large: set[int], piece: int) -> Iterator[_Part]:
    around = (*around, value)
    members: list[Any] = []
    size, is_first = 0, True
    inside: list[Any] = []
    for key in value if isinstance(value, dict) else range(len(value)):
        member = value[key]
        if id(member) in large:
            inside.append(key)
            if isinstance(value, dict):
                continue
        own = 0 if id(member) in large else _size(member)
        if members and (size + own > piece or id(member) in large):
            yield _Part(around, path, tuple(members), is_first)
            members, size, is_first = [], 0, False
        if id(member) not in large:
            members.append(key)
            size += own
    if members or is_first:
        yield _Part(around, path, tuple(members), is_first)
    for key in inside:
        yield from _parts(value[key], around, (*path, key), large, piece)


def _size(value: Any) -> int:
    members = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + sum(map(_size, members))


def _with(collection: Any, members: dict[Any, Any]) -> Any:
    """Return a copy of a collection with these members; of a mapping also a little of its other keys.

    Another key, such as `kind`, can determine how they are read.
    """
    if isinstance(collection, list):
        return list(members.values())
    beside = {key: _sample(value, _LEVELS) for key, value in islice(collection.items(), _BESIDE)}
    return {**beside, **members}


def _sample(value: Any, levels: int) -> Any:
    if isinstance(value, dict):
        return {key: _sample(value[key], levels - 1) for key in islice(value, _SAMPLE if levels else 0)}
    return (
        [_sample(member, levels - 1) for member in value[: _SAMPLE if levels else 0]]
        if isinstance(value, list)
        else value
    )
