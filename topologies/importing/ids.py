"""Node ids from the names and labels of a source, which may hold any text."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Hashable, Sequence

from hedgerow.topologies.base import node_id

_LONGEST = 60
_OTHERS = re.compile(r"[^A-Za-z0-9_.-]+")
Ids = list[int | str]


def ids_of(names: Sequence[Hashable], labels: Sequence[str | None] | None) -> tuple[Ids, list[str | None], int]:
    """Return the ids of nodes, their labels, and the number of ids that differ from the node's name.

    An id is made from the label if every node has one and all differ; otherwise from the name. Characters that an id
    cannot have become `_`. A repeated id gets the suffix `_2`, `_3`, … If an id differs from the name of its node, the
    name becomes the label.
    """
    by_label = labels is not None and all(labels) and len(set(labels)) == len(labels)
    wanted: Sequence[Hashable] = labels if by_label and labels is not None else names
    taken: set[int | str] = set()
    ids: Ids = []
    printed: list[str | None] = []
    made = 0
    # Give every node first its name, if that is a valid id: a made id never takes the name of another node.
    own = [_whole(one) for one in wanted]
    reserved = {one for one in own if one is not None}
    for k, (name, plain) in enumerate(zip(wanted, own, strict=True)):
        if plain is not None and plain not in taken:
            node = plain
        else:
            node = _free(_spelled(name) or f"node_{k + 1}", taken, reserved)
            made += 1
        taken.add(node)
        ids.append(node)
        label = labels[k] if labels is not None else None
        printed.append(label or (None if plain is not None and node == plain else _printable(name)))
    return (
        ids,
        [
            None if label is None or label == str(node) else _printable(label)
            for label, node in zip(printed, ids, strict=True)
        ],
        made,
    )


def _whole(name: Hashable) -> int | str | None:
    """Return the id that equals a name, or None if the name is not a valid id."""
    if isinstance(name, bool):
        return None
    if isinstance(name, float) and name.is_integer():
        return int(name)
    if type(name).__module__ == "numpy" and hasattr(name, "item"):
        return _whole(name.item())
    if isinstance(name, int):
        return name if abs(name) < 2**63 else None
    if isinstance(name, str) and len(name) <= 64 and re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name):
        found: int | str = node_id(name)
        return found if isinstance(found, str) or abs(found) < 2**63 else None
    return None


def _spelled(name: Hashable) -> str:
    """Return a name reduced to the characters of ids; empty if none remains."""
    text = "_".join(map(str, name)) if isinstance(name, tuple | frozenset) else str(name)
    ascii_ = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return _OTHERS.sub("_", ascii_).strip("_.-")[:_LONGEST].rstrip("_.-")


def _free(text: str, taken: set[int | str], reserved: set[int | str]) -> int | str:
    node: int | str = node_id(text)
    count = 1
    while node in taken or node in reserved:
        count += 1
        node = f"{text}_{count}"
    return node


def _printable(value: object) -> str:
    """Return a label for a text: one line of printable characters, at most 200."""
    text = "".join(one if one.isprintable() else " " for one in str(value))
    return " ".join(text.split())[:200] or "?"
