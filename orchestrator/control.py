"""Talking to the plant of a running network."""

from __future__ import annotations

import json
from typing import Any

import zenoh

from wire.session import WireError


def ask(session: zenoh.Session, key: str, timeout_s: float = 2.0) -> dict[str, Any]:
    """The plant's answer to a query on `key`; raises WireError when none comes in time."""
    for reply in session.get(key, timeout=timeout_s):
        if reply.ok is not None:
            answer: dict[str, Any] = json.loads(reply.ok.payload.to_string())
            return answer
    raise WireError(f"the plant did not answer {key} within {timeout_s:g} s")
