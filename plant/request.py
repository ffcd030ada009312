"""The checks of a query to the plant: any process may ask, so every field is checked, and the reply names what is
wrong.

Every function here raises UserError with a text that is the reply.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Graph
from hedgerow.wire import bounded_json

Request = Mapping[str, Any]

LEAST_BYTES, BYTES_PER_INCIDENCE = 2**20, 64
"""A fault may strike every link of the network and name each of them."""
TEXT = 200
"""The maximum length of a name; a refused value is quoted up to this length."""


def read(payload: bytes, graph: Graph) -> Request:
    """Return the JSON object in a query."""
    most = LEAST_BYTES + BYTES_PER_INCIDENCE * len(graph.node)
    try:
        request = bounded_json.decode(payload, most)
    except ValueError as error:
        raise UserError(f"no request in JSON: {shortened(error)}", code=Code.MESSAGE) from None
    if not isinstance(request, dict):
        raise UserError(f"{shortened(request)} is no JSON object", code=Code.MESSAGE)
    return request


def shortened(what: object) -> str:
    """Return a refused value as one short line."""
    shown = ascii(what) if not isinstance(what, Exception) else ascii(str(what))[1:-1]
    return shown if len(shown) <= TEXT else f"{shown[:TEXT]}…"


def integer(request: Request, key: str, low: int, high: int) -> int:
    """Return an integer from low to high."""
    value = request.get(key)
    if type(value) is not int or not low <= value <= high:
        raise UserError(f"{key}: {shortened(value)} is no integer from {low} to {high}", code=Code.OPTION)
    return value


def number(request: Request, key: str, low: float, high: float) -> float:
    """Return a number from low to high."""
    value = request.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise UserError(f"{key}: {shortened(value)} is no number from {low:g} to {high:g}", code=Code.OPTION)
    return float(value)


def text(request: Request, key: str) -> str | None:
    """Return a printable name, or None."""
    value = request.get(key)
    if value is None or (isinstance(value, str) and len(value) <= TEXT and value.isprintable()):
        return value
    raise UserError(f"{key}: {shortened(value)} is no name", code=Code.OPTION)


def _is_step(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= FOREVER


def _step(key: str) -> int:
    if not (key.isascii() and key.isdecimal() and len(key) <= len(str(FOREVER))) or int(key) > FOREVER:
        raise UserError(f"at: {shortened(key)} is no step", code=Code.FAULT)
    return int(key)


def entry(request: Request) -> Mapping[str, Any]:
    """Return a fault entry as in a file: an object with steps that can be moved."""
    value = request.get("entry")
    if not isinstance(value, dict) or text(value, "kind") is None:
        raise UserError(f"entry: {shortened(value)} is no fault as a file spells it", code=Code.FAULT)
    window, at = value.get("steps"), value.get("at")
    if "steps" in value and not (isinstance(window, list) and len(window) == 2 and all(map(_is_step, window))):
        raise UserError(f"entry: steps: {shortened(window)} is no window of steps", code=Code.FAULT)
    if isinstance(at, dict):
        for key in at:
            _step(key)
    elif "at" in value:
        integer(value, "at", 0, FOREVER)
    return value


def shard(who: str, shards: int) -> int:
    """Return the number of the asking shard, from the last chunk of its key."""
    if not who.isascii() or not who.isdecimal() or len(who) > 9 or int(who) >= shards:
        raise UserError(f"{shortened(who)} is not one of the {shards} agent processes", code=Code.OPTION)
    return int(who)
