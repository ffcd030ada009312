"""Numbers with two readings: 007 and 012, which are text, decimal or octal, and 1e3 as a node id."""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from typing import Any

from hedgerow.topologies.errors import Code, Problem
from hedgerow.topologies.source import Path, Source, place_of

_LEADING_ZERO = re.compile(r"[-+]?0[0-9]")
_NAMING = frozenset(("link", "from", "to", "edge", "node", "groups"))
"""keys of faults that name nodes"""


def odd_numbers(source: Source) -> Iterator[Problem]:
    """Report every whole number with a second reading."""
    for path, text in source.odd.items():
        if not _at(source, path):
            continue
        if _names_node(path):
            value = _number(text)
            yield source.problem(
                path,
                f"{text} can be the whole number {value} or a name",
                f'write {value} for the number, or "{text}" in quotes for the name',
                Code.FILE_AMBIGUOUS,
                "nodes" if path[0] == "nodes" else place_of(path),
            )
        elif _LEADING_ZERO.match(text):
            value = _value(source.value, path)
            yield source.problem(
                path,
                f"{text} begins with 0, which makes it octal for some readers of YAML and decimal for others",
                f"write {value}" + (f', or "{text}" in quotes for text' if path[-1] == "name" else ""),
                Code.FILE_AMBIGUOUS,
            )


def _number(text: str) -> int:
    """Return the whole number that a reader of YAML may take a text for."""
    digits = text.replace("_", "")
    sign, plain = ("-", digits[1:]) if digits[:1] == "-" else ("", digits.removeprefix("+"))
    if plain[:2].lower() in ("0x", "0o", "0b"):
        return int(sign + plain, 0)
    return int(Decimal(sign + plain))


def no_id(node: Any, text: str | None, shown: str) -> tuple[str, str, Code]:
    """Return the problem of an invalid node id: the problem, the fix, the code."""
    if isinstance(node, dict):
        return f"{shown} is no node id", "write `ID: {…}`", Code.TOPOLOGY
    if isinstance(node, list):
        return f"{shown} is no node id", "use names or whole numbers", Code.TOPOLOGY
    text = shown if text is None else text
    if not text or text == "~":
        return "an empty value is no node id", "use names or whole numbers", Code.TOPOLOGY
    cure = f'write "{text}" in quotes if it is a name'
    if isinstance(node, float) and node.is_integer() and abs(node) < 1e18:
        cure += f", or {int(node)} if it is a number"
    return f"{text} is no node id", f"{cure}; ids are names or whole numbers", Code.FILE_AMBIGUOUS


def _names_node(path: Path) -> bool:
    match path:
        case ("nodes", _) | ("edges", _, int()) | ("edges", _, "ends", _) | ("record", "nodes", _):
            return True
        case ("faults", _, "at", _, *rest):
            return bool(rest)
        case ("faults", _, key, *_):
            return key in _NAMING
    return False


def _value(value: Any, path: Path) -> Any:
    for step in path:
        value = value[step]
    return value


def _at(source: Source, path: Path) -> bool:
    """Return True if the file still has the number there: a mistake or an option may have removed it."""
    try:
        _value(source.value, path)
    except (LookupError, TypeError):
        return False
    return True
