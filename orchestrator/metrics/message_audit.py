"""The audit of the messages of a run: each is counted at its sender and at its receiver.

A message that its only permitted sender did not send came from an intruder, over any router.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hedgerow.topologies.escape import shorten
from hedgerow.wire import keys
from hedgerow.wire.access import OBSERVER, Place

if TYPE_CHECKING:
    from hedgerow.wire.session import Receiver, Sender
    from hedgerow.wire.stream import Inbox

CLAIM = "every message that a process received was sent by the only process that may publish on its key"


@dataclass(frozen=True)
class Channel:
    """One key: its permitted sender, its receiver, and the numbers of messages; None for an unknown number."""

    key: str
    sender: str
    receiver: str
    sent: int | None = None
    received: int | None = None
    refused: int | None = None
    """the number of received messages that were not valid on this key"""

    def entry(self) -> dict[str, Any]:
        """Return the channel as verdict.json holds it."""
        counts = {"sent": self.sent, "received": self.received, "refused": self.refused}
        return {"key": self.key, "sender": self.sender, "receiver": self.receiver, **counts}

    @property
    def wrong(self) -> str:
        """Return the discrepancy in words; empty if there is none."""
        if self.sent is None or self.received is None or self.received <= self.sent:
            return ""
        return f"{self.receiver} received {self.received} messages on {self.key}, but {self.sender} sent {self.sent}"


def channels(places: Sequence[Place]) -> list[Channel]:
    """Return the channels between plant and agents: no other message reaches any of them."""
    names = {place.shard: place.name for place in places}
    found = []
    for name, p, peers, *_ in places:
        found.append(Channel(keys.state(p), keys.PLANT, name))
        found.append(Channel(keys.input_(p), name, keys.PLANT))
        found += [Channel(keys.link(q, p), names[q], name) for q in peers]
    return found


OBSERVED = (Channel(keys.TELEMETRY, keys.PLANT, OBSERVER), Channel(keys.SEEN, OBSERVER, keys.PLANT))
"""The two keys between plant and observer."""


@dataclass(frozen=True)
class Audit:
    """The result of the audit of a run."""

    channels: Sequence[Channel]
    strange: Mapping[str, Mapping[str, int]]
    """by process: messages that arrived on unassigned keys"""
    silent: Sequence[str]
    """processes that did not report their counts at the end"""
    observer: Sequence[Channel] = OBSERVED
    """the keys between plant and observer"""

    @property
    def wrong(self) -> list[str]:
        """Return the discrepancies in words."""
        strange = [
            f"{name} received {number} messages on {key}, which no process uses"
            for name, some in self.strange.items()
            for key, number in some.items()
        ]
        return [why for channel in (*self.channels, *self.observer) if (why := channel.wrong)] + strange

    def to_dict(self) -> dict[str, Any]:
        """Return the audit as in verdict.json."""
        listed = [channel.entry() for channel in self.channels]
        observer = [channel.entry() for channel in self.observer]
        return {"channels": listed, "observer": observer, "strange": self.strange, "silent": self.silent}


def audit(places: Sequence[Place], event: Mapping[str, Any], observed: Mapping[str, Any] | None = None) -> Audit:
    """Return the audit from the counts of the processes, in the plant's event `counts`, and from the observer's counts.

    A process without a final report has died or hangs, so its counts are unknown. A restarted process knows only the
    counts of its last life.
    """
    reports = {keys.PLANT: event["plant"]}
    lives = {keys.PLANT: 0}
    if observed is not None:
        reports[OBSERVER], lives[OBSERVER] = observed, 0
    for place, report in zip(places, event["shards"], strict=True):
        if is_counted(report) and isinstance(report.get("life"), int):
            reports[place.name], lives[place.name] = report, report["life"]
    counted, observer = ([_counted(one, reports, lives) for one in some] for some in (channels(places), OBSERVED))
    strange = {name: _shortened(report["strange"]) for name, report in reports.items() if report["strange"]}
    return Audit(counted, strange, [place.name for place in places if place.name not in reports], observer)


def observed(seen: Sender, receiver: Receiver, inbox: Inbox) -> dict[str, Any]:
    """Return the observer's counts at the time of the plant's counts, in the form of an agent's final report."""
    refused = {receiver.key: inbox.refused} if inbox.refused else {}
    received = {receiver.key: inbox.arrived_at_event}
    return {"sent": {seen.key: seen.sent}, "received": received, "refused": refused, "strange": receiver.strange}


STRANGE_KEYS = 16
"""the maximum number of unassigned keys per process that a verdict names"""
_LARGEST_COUNT = 2**63 - 1


def _shortened(strange: Mapping[str, int]) -> dict[str, int]:
    """Return the first 16 unassigned keys, each in at most 80 characters, and the others as one sum.

    The final report of an agent is a text from another machine: it can hold any number of keys of any length.
    """
    found: dict[str, int] = {}
    for k, (key, number) in enumerate(strange.items()):
        name = shorten(key) if k < STRANGE_KEYS else f"{len(strange) - STRANGE_KEYS} more keys"
        found[name] = max(-1, min(found.get(name, 0) + number, _LARGEST_COUNT))
    return found


def _counted(one: Channel, reports: Mapping[str, Any], lives: Mapping[str, int]) -> Channel:
    """Return a channel with the counts of both ends."""
    received = reports.get(one.receiver)
    return Channel(
        one.key,
        one.sender,
        one.receiver,
        reports[one.sender]["sent"].get(one.key) if lives.get(one.sender) == 0 else None,
        None if received is None else received["received"].get(one.key),
        None if received is None else received["refused"].get(one.key, 0),
    )


def is_counted(report: Any) -> bool:
    """Return True if `report`, from another process, is a valid final report."""
    tables = (
        [report.get(name) for name in ("sent", "received", "refused", "strange")]
        if isinstance(report, dict)
        else [None]
    )
    return all(
        isinstance(table, dict) and all(isinstance(number, int) for number in table.values()) for table in tables
    )
