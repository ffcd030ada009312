"""The line of an event of events.jsonl, on the screen and in the viewer's log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class EventLine(NamedTuple):
    """A text, its level (INFO, WARN or ERROR) and its step."""

    text: str
    level: str
    step: int


def event_line(event: Mapping[str, Any]) -> EventLine | None:
    """Return the line of a recorded event; None if it needs no line."""
    match event:
        case {"event": "lost", "who": who, "cause": cause, "step": step}:
            return EventLine(f"step {step}: going on without {who}: {cause}", "WARN", step)
        case {"event": "back", "who": who, "at": step}:
            return EventLine(f"step {step}: {who} is back", "INFO", step)
        case {"event": "fault", "fault": number, "at": step}:
            return EventLine(f"step {step}: fault {number} begins", "WARN", step)
        case {"event": "heal", "fault": number, "at": step}:
            return EventLine(f"step {step}: fault {number} ends", "INFO", step)
    return None
