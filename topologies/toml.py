"""Settings as TOML, which people and every Python can read: the format of the configs of remote processes."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import memory

_HEAD = re.compile(r"^[^=\n#]*", re.MULTILINE)
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def dumps(settings: Mapping[str, Any]) -> str:
    """Return `settings` as TOML; numbers return bit for bit, and None is left out.

    Single values come first; a mapping becomes a table, and a list of mappings an array of tables, one level deep.
    """
    lines, tables = [], []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            tables += ["", f"[{_key(key)}]", *_lines(value)]
        elif _is_list(value) and value and all(isinstance(one, Mapping) for one in value):
            for one in value:
                tables += ["", f"[[{_key(key)}]]", *_lines(one)]
        else:
            lines += _lines({key: value})
    return "\n".join([*lines, *tables]) + "\n"


def loads(text: str, source: str) -> dict[str, Any]:
    """Return the settings in a text; raise UserError, which names its `source`, if it is not TOML."""
    budget.require(source, memory(text.encode(errors="replace")) + _parsed(text))
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError alone if a whole number has too many digits
        why = "it is nested too deep" if isinstance(error, RecursionError) else error
        raise UserError(
            f"{source}: is not TOML: {why}; take the file that `orchestrator bundle` wrote", code=Code.FILE_FORMAT
        ) from None


def _parsed(text: str) -> int:
    """Return an upper bound of the memory for the keys and tables of a text during parsing [bytes].

    A key can be the only one of its table. The parser has three collections for each table and each part of a dotted
    key, and a tuple of all parts before it.
    """
    dots: list[int] = [head.count(".") for head in _HEAD.findall(text)]
    tables = sum(dots) + text.count("\n[")
    return 300 * text.count("=") + 1300 * tables + 8 * sum(parts * parts for parts in dots)


def _lines(settings: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in settings.items() if value is not None]


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(_lines(value)) + "}"
    if _is_list(value):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, float):
        return repr(value)  # nan and inf are valid TOML too
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
