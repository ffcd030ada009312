"""Requests to the plant of a running network."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from typing import Any

import zenoh

from hedgerow.wire import bounded_json, keys
from hedgerow.wire.session import WireError


def ask(
    session: zenoh.Session, command: str, request: Mapping[str, Any] | None = None, timeout_s: float = 2.0
) -> dict[str, Any]:
    """Return the plant's answer to a command of plant/control.py; raise WireError if there is none in time."""
    key = keys.control(command)
    for reply in session.get(key, payload=json.dumps(request or {}), timeout=timeout_s):
        if reply.ok is not None:
            try:
                answer = bounded_json.decode(reply.ok.payload.to_bytes())
            except ValueError as error:
                raise WireError(f"{key}: the answer is no JSON: {error}") from None
            if not isinstance(answer, dict):
                raise WireError(f"{key}: the answer is no JSON object")
            return answer
    raise WireError(f"the plant did not answer {key} within {timeout_s:g} s")


def tell_died(session: zenoh.Session, shard: int, life: int, timeout_s: float) -> bool | None:
    """Report to the plant that a life of a shard has ended.

    Return True if that life had reached the router, False if not, and None if the report must be repeated.
    """
    with contextlib.suppress(WireError):
        answer = ask(session, "died", {"shard": shard, "life": life}, timeout_s)
        return None if answer.get("wait") else not answer.get("unreached", False)
    return None
