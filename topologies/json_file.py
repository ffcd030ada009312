"""JSON files that may come from others: regular, bounded in memory and depth, and refused with a clear message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
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
        return json.loads(text)
    except (ValueError, RecursionError, MemoryError) as error:
        why = "it is nested too deep" if isinstance(error, RecursionError) else error
        raise UserError(
            f"{place}: cannot be read as JSON: {why}. Write the file again.", code=Code.FILE_FORMAT
        ) from None


def memory(text: bytes) -> int:
    """Return an upper bound of the memory of a parsed JSON text [bytes], by counting the start characters of values."""
    # An empty list takes 2 characters and 64 bytes, an object with one key 232 bytes, a text 49 bytes and its letters.
    values = 60 * text.count(b",") + 100 * text.count(b"[") + 300 * text.count(b"{") + 40 * text.count(b'"')
    return values + len(text) * (1 if text.isascii() else 4)
