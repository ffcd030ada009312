"""Who heard what: every message between plant and agents, counted where it is said and where it is heard.

A message that its rightful sender did not say was said by somebody else, over however open a router it came.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hedgerow.wire import keys
from hedgerow.wire.access import Place

CLAIM = "every message that a process took in was said to it, by the one process that may speak on its key"


@dataclass(frozen=True)
class Channel:
    """One key: who may say something on it, to whom, and how many messages that were; None where nobody knows."""

    key: str
    speaker: str
    listener: str
    said: int | None = None
    heard: int | None = None
    refused: int | None = None
    """of those that came, how many were no message of this key"""

    @property
    def wrong(self) -> str:
        """What is not as it may be, in words; empty where nothing is."""
        if self.said is None or self.heard is None or self.heard <= self.said:
            return ""
        return f"{self.listener} heard {self.heard} messages on {self.key}, of which {self.speaker} said {self.said}"


def channels(places: Sequence[Place]) -> list[Channel]:
    """Who may hear whom, of plant and agents: nothing else reaches any of them."""
    names = {place.shard: place.name for place in places}
    found = []
    for name, p, peers, *_ in places:
        found.append(Channel(keys.state(p), keys.PLANT, name))
        found.append(Channel(keys.input_(p), name, keys.PLANT))
        found += [Channel(keys.link(q, p), names[q], name) for q in peers]
    return found


@dataclass(frozen=True)
class Audit:
    """What became of the information structure in a run."""

    channels: Sequence[Channel]
    strange: Mapping[str, Mapping[str, int]]
    """by process: messages that came on keys of nobody"""
    silent: Sequence[str]
    """processes that did not say at the end what they had said and heard"""

    @property
    def wrong(self) -> list[str]:
        """Who heard what should not have been heard."""
        strange = [
            f"{name} was sent {number} messages on {key}, which is nobody's"
            for name, some in self.strange.items()
            for key, number in some.items()
        ]
        return [why for channel in self.channels if (why := channel.wrong)] + strange

    def to_dict(self) -> dict[str, Any]:
        """As verdict.json holds it."""
        listed = [asdict(channel) for channel in self.channels]
        return {"channels": listed, "strange": self.strange, "silent": self.silent}


def audit(places: Sequence[Place], event: Mapping[str, Any]) -> Audit:
    """What the processes counted, as the plant's event `heard` tells it.

    Who did not say a last word has died or hangs, and what it said before is not known; a process in its second life
    knows only what it said and heard in that.
    """
    words = {keys.PLANT: event["plant"]}
    lives = {keys.PLANT: 0}
    for place, word in zip(places, event["shards"], strict=True):
        if is_counted(word) and isinstance(word.get("life"), int):
            words[place.name], lives[place.name] = word, word["life"]
    counted = [
        Channel(
            one.key,
            one.speaker,
            one.listener,
            words[one.speaker]["said"].get(one.key) if lives.get(one.speaker) == 0 else None,
            words[one.listener]["heard"].get(one.key) if one.listener in words else None,
            words[one.listener]["refused"].get(one.key, 0) if one.listener in words else None,
        )
        for one in channels(places)
    ]
    strange = {name: word["strange"] for name, word in words.items() if word["strange"]}
    return Audit(counted, strange, [place.name for place in places if place.name not in words])


def is_counted(word: Any) -> bool:
    """Return True if `word`, which came over the wire, is what a process says at its end."""
    tables = [word.get(name) for name in ("said", "heard", "refused", "strange")] if isinstance(word, dict) else [None]
    return all(
        isinstance(table, dict) and all(isinstance(number, int) for number in table.values()) for table in tables
    )
