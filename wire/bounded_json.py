"""JSON from the network: bounded in bytes, values and depth, and rebuilt from plain types before it is used."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from hedgerow.topologies import budget
from hedgerow.topologies.json_file import memory, unique

MOST_BYTES = 2**28
MOST_VALUES = 5_000_000
"""An upper bound of the number of values in a text, from its commas and brackets, before it is parsed."""
_COPIES = 2
"""the parsed value, and the one that is rebuilt from it"""
MOST_DEPTH = 8
"""Our own messages have at most 5 levels.

A deeper text could be parsed here and overflow the stack when it is written again.
"""


def decode(text: bytes, most_bytes: int = MOST_BYTES) -> Any:
    """Return the value in a JSON text; raise ValueError for a text that is broken or beyond a bound.

    Lone surrogates, NaN and infinite numbers are refused, so the result can be written as JSON and as UTF-8.
    """
    if len(text) > most_bytes:
        raise ValueError(f"{len(text)} bytes, and at most {most_bytes} are read")
    if 1 + text.count(b",") + text.count(b"[") + text.count(b"{") > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} values")
    if why := budget.excess(_COPIES * memory(text)):
        raise ValueError(why)
    try:
        parsed = json.loads(text.decode("utf-8"), object_pairs_hook=unique, parse_constant=_refuse_constant)
        return _plain(parsed, MOST_DEPTH)
    except (RecursionError, MemoryError):
        raise ValueError(_TOO_DEEP) from None


_TOO_DEEP = f"nested more than {MOST_DEPTH} deep"


def _plain(value: Any, depth: int) -> Any:
    """Return a copy of `value` that has at most `depth` levels of lists and objects."""
    if isinstance(value, dict | list) and not depth:
        raise ValueError(_TOO_DEEP)
    if isinstance(value, dict):
        return {_text(key): _plain(inside, depth - 1) for key, inside in value.items()}
    if isinstance(value, list):
        return [_plain(inside, depth - 1) for inside in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a number that is not finite")
    return _text(value) if isinstance(value, str) else value


def _text(text: str) -> str:
    if not text.isascii():
        text.encode()  # raises UnicodeEncodeError, a ValueError, for a lone surrogate
    return text


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number")
