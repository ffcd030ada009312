"""Settings as TOML, which people and every Python can read: the format of the configs of remote processes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from hedgerow.topologies import budget
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.json_file import memory

_HEAD = re.compile(r"^[^=\n#]*", re.MULTILINE)


def dumps(settings: Mapping[str, Any]) -> str:
    """Return settings as TOML. Reading them gives numbers of the same bits. A key with the value None is left out."""
    import tomlkit  # noqa: PLC0415 (an agent on a small computer reads TOML, and does not have this package)

    return tomlkit.dumps(_without_none(settings))


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(one) for key, one in value.items() if one is not None}
    return [*map(_without_none, value)] if isinstance(value, list | tuple) else value


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
