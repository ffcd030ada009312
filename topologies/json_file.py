"""JSON files that may come from others: regular, bounded in memory and depth, and refused with a clear message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.escape import shorten
from hedgerow.topologies.foreign import not_text
from hedgerow.topologies.regular_file import read_regular


def read_json(path: Path, inside: Path | None = None) -> Any:
    """Return the value in a JSON file; OSError passes.

    inside: the folder that a symbolic link must not lead out of. Raise UserError for a file that is not regular, is not
    JSON, or takes more memory than allowed.
    """
    return loads(path, read_regular(path, inside))


def loads(place: object, text: bytes) -> Any:
    """Return the value in a JSON text; raise UserError, which begins with `place`, if it is invalid or too large."""
    budget.require(place, memory(text))
    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=_refuse_constant)
    except (ValueError, RecursionError, MemoryError) as error:
        raise UserError(
            f"{place}: cannot be read as JSON: {_why(text, error)}. Write the file again.", code=Code.FILE_FORMAT
        ) from None


def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the object of some pairs; raise ValueError if a key occurs twice, because readers differ in which counts.

    This is a hook for `json.loads`.
    """
    made = dict(pairs)
    if len(made) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for k, key in enumerate(keys) if key in keys[:k]) if len(keys) <= _SEARCHED else "a key"
        raise ValueError(f"`{shorten(twice)}` occurs twice in one object")
    return made


_SEARCHED = 1000


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _why(text: bytes, error: BaseException) -> str:
    """Return the cause of an error of the parser, in our words where its own name a part of Python."""
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    if isinstance(error, UnicodeDecodeError):
        return not_text(text, error)
    if isinstance(error, MemoryError):
        return "it takes more memory than there is"
    if "int_max_str_digits" in str(error):
        return "a number has more than 4300 digits"
    return not_text(text) or str(error)


def memory(text: bytes) -> int:
    """Return an upper bound of the memory of a parsed JSON text [bytes], by counting the start characters of values."""
    # An empty list takes 2 characters and 64 bytes, an object with one key 232 bytes, a text 49 bytes and its letters.
    values = 60 * text.count(b",") + 100 * text.count(b"[") + 300 * text.count(b"{") + 40 * text.count(b'"')
    return values + len(text) * (1 if text.isascii() else 4)
