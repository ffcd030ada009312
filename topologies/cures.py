"""Fixes for a value that should be a number or a text."""

from __future__ import annotations

import contextlib
import json
import math
import re
import unicodedata
from typing import Any

from hedgerow.topologies.source import FLOAT

_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_INTEGER = re.compile(r"[-+]?\d+")
_GROUPED = re.compile(r"[-+]?\d+([_ '\u00a0\u2009\u202f]\d+)+(\.\d+)?")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d+)?")
_PARTS = re.compile(r"([-+]?\d{1,15}) ?(?:/ ?([1-9]\d{0,14})|%)")
_UNIT = re.compile(r"([-+]?\d{1,15}(?:\.\d+)?) ?[a-zA-Z]{1,12}")
_OTHER_BASE = re.compile(r"[-+]?0[xXoObB][0-9a-fA-F]{1,15}")


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
        case str() if found := _number_in_other_words(value, whole):
            cure = f"write {found}"
        case str() if _DECIMAL_COMMA.fullmatch(value):
            cure = f"write a point: {value.replace(',', '.')}"
        case str() if FLOAT.match(value) and (not whole or _INTEGER.fullmatch(value)):
            cure = f"write it without quotes: {value}"
        case str() if _GROUPED.fullmatch(value):
            cure = f"write the digits alone: {''.join(re.findall(r'[-+.0-9]', value))}"
        case _:
            cure = f"write a {'whole ' * whole}number, such as {example}"
    return cure


def _number_in_other_words(text: str, whole: bool) -> str:
    """Return the number of a text that people, other languages or other keyboards write so; empty if there is none."""
    if text != (narrow := unicodedata.normalize("NFKC", text).replace("\u2212", "-")) and FLOAT.match(narrow):
        return narrow
    if _THOUSANDS.fullmatch(text):
        plain = text.replace(",", "")
        certain = whole or text.count(",") > 1 or "." in text
        return plain if certain else f"{plain}, or {text.replace(',', '.')} if the comma is a decimal point"
    if parts := _PARTS.fullmatch(text):
        value = int(parts[1]) / int(parts[2] or 100)
        if not whole or value.is_integer():
            return repr(int(value) if value.is_integer() else value)
    if _OTHER_BASE.fullmatch(text):
        with contextlib.suppress(ValueError):
            return str(int(text, 0))
    unit = _UNIT.fullmatch(text)
    return f"the number alone: {unit[1]}" if unit and not (whole and "." in unit[1]) else ""


def cure_of_text(value: Any, text: str | None) -> str:
    """Return the fix for a value that should be a text."""
    if isinstance(value, list | dict):
        return "write a single text"
    if value is None and not text:
        return "write a name"
    return f'put it in quotes: "{text or json.dumps(value, default=str)}"'
