"""An event from the plant to the observer: rebuilt from its permitted fields, or refused.

In an open network any process may write on `telemetry`, so the next message may come from a stranger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hedgerow.orchestrator.metrics.message_audit import is_counted
from hedgerow.wire.message import MessageError

Check = Callable[[Any], bool]


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**62


def _is_rate(value: Any) -> bool:
    return type(value) in (int, float) and 0 <= value < float("inf")


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict)


def _fields(shards: int, faults: int) -> Mapping[str, Mapping[str, Check]]:
    """Return the fields of each event, in a run with these numbers of shards and, until now, faults."""

    def is_shard(value: Any) -> bool:
        return _is_count(value) and value < shards

    def is_fault(value: Any) -> bool:
        return _is_count(value) and value < faults

    def is_words(value: Any) -> bool:
        return isinstance(value, Sequence) and len(value) == shards

    return {
        "counts": {"plant": is_counted, "shards": is_words},
        "kill": {"shard": is_shard, "life": _is_count, "restart": lambda value: isinstance(value, bool)},
        "revive": {"shard": is_shard},
        "lost": {"shard": is_shard, "fault": _is_count, "who": _is_text, "cause": _is_text},
        "back": {"shard": is_shard, "fault": is_fault, "who": _is_text, "at": _is_count},
        "fault": {"fault": _is_count, "entry": _is_table, "at": _is_count},
        "heal": {"fault": is_fault, "at": _is_count},
        "refused": {"who": _is_text, "cause": _is_text},
        "pause": {"at": _is_count},
        "resume": {"at": _is_count},
        "rate": {"at": _is_count, "rate": _is_rate},
    }


def checked(event: Mapping[str, Any], shards: int, faults: int) -> dict[str, Any]:
    """Return the event with only its known fields.

    Raise MessageError for an event that no plant of such a run sends.
    """
    kind = event.get("event")
    fields = _fields(shards, faults).get(kind) if isinstance(kind, str) else None
    if fields is None:
        raise MessageError(f"an event {str(kind)[:40]!a}, which no plant sends")
    for name, fits in fields.items():
        if not fits(event.get(name)):
            raise MessageError(f"an event {kind} with the {name} {str(event.get(name))[:40]!a}")
    return {"event": kind, "step": event["step"], **{name: event[name] for name in fields}}
