"""The mistakes of values that pydantic finds outside of topology files, without its own words."""

from __future__ import annotations

import json
from typing import get_args

from pydantic_core import ErrorDetails, core_schema

from hedgerow.topologies.escape import shorten

_EXPECTED = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("list_type", "tuple_type", "set_type"), "a list"),
    **dict.fromkeys(("dict_type", "model_type"), "a mapping"),
    "string_type": "text",
    "finite_number": "a finite number",
}


def in_our_words(details: ErrorDetails) -> str:
    """Return a mistake of the schema, with its value, for a place that is no key of a topology."""
    kind, context = details["type"], details.get("ctx", {})
    if kind == "missing":
        return "is missing"
    if kind not in _OF_THE_LIBRARY:
        return f"{details['msg'][:1].lower()}{details['msg'][1:]}"
    shown = shorten(json.dumps(details["input"], default=str, ensure_ascii=False), 60)
    if kind in _EXPECTED:
        return f"{shown} is not {_EXPECTED[kind]}"
    bounds = [f"{words} {context[key]}" for key, words in _BOUNDS.items() if key in context]
    return f"{shown} is not {' and '.join(bounds)}" if bounds else f"{shown} does not fit"


_BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
_OF_THE_LIBRARY = frozenset(get_args(core_schema.ErrorType))
