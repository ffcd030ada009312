"""Fixes for a value that should be a number or a text."""

from __future__ import annotations

import json
import math
import re
from typing import Any

from hedgerow.topologies.source import FLOAT

_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_INTEGER = re.compile(r"[-+]?\d+")
_GROUPED = re.compile(r"[-+]?\d+(_\d+)+(\.\d+)?")


def cure_of_number(value: Any, whole: bool = False) -> str:
    """Return the fix for a value that should be a number."""
    example = "3" if whole else "0.5"
    match value:
        case [int() | float() as inside] if not isinstance(inside, bool):
            return f"write a single number, without brackets: {inside}"
        case list() | dict():
            return f"write a single number, without brackets, such as {example}"
        case None:
            cure = f"write a number, such as {example}, or remove the key"
        case float() if abs(value) > 2**63:
            cure = "choose a smaller one"
        case float():
            cure = f"write {round(value)}" if math.isfinite(value) and value.is_integer() else "write a whole number"
        case str() if _DECIMAL_COMMA.fullmatch(value):
            cure = f"write a point: {value.replace(',', '.')}"
        case str() if FLOAT.match(value) and (not whole or _INTEGER.fullmatch(value)):
            cure = f"write it without quotes: {value}"
        case str() if _GROUPED.fullmatch(value):
            cure = f"write the digits alone: {value.replace('_', '')}"
        case _:
            cure = f"write a {'whole ' * whole}number, such as {example}"
    return cure


def cure_of_text(value: Any, text: str | None) -> str:
    """Return the fix for a value that should be a text."""
    if isinstance(value, list | dict):
        return "write a single text"
    if value is None and not text:
        return "write a name"
    return f'put it in quotes: "{text or json.dumps(value, default=str)}"'
