"""Who heard what: every message of a run, counted where it is said and where it is heard.

A message that its rightful sender did not say was said by somebody else, over however open a router it came.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hedgerow.topologies.escape import shorten
from hedgerow.wire import keys
from hedgerow.wire.access import OBSERVER, Place

if TYPE_CHECKING:
    from hedgerow.wire.session import Receiver, Sender
    from hedgerow.wire.stream import Inbox

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


OBSERVED = (Channel(keys.TELEMETRY, keys.PLANT, OBSERVER), Channel(keys.SEEN, OBSERVER, keys.PLANT))
"""The two keys between plant and observer."""


@dataclass(frozen=True)
class Audit:
    """What became of the information structure in a run."""

    channels: Sequence[Channel]
    strange: Mapping[str, Mapping[str, int]]
    """by process: messages that came on keys of nobody"""
    silent: Sequence[str]
    """processes that did not say at the end what they had said and heard"""
    observer: Sequence[Channel] = OBSERVED
    """the keys between plant and observer"""

    @property
    def wrong(self) -> list[str]:
        """Who heard what should not have been heard."""
        strange = [
            f"{name} was sent {number} messages on {key}, which is nobody's"
            for name, some in self.strange.items()
            for key, number in some.items()
        ]
        return [why for channel in (*self.channels, *self.observer) if (why := channel.wrong)] + strange

    def to_dict(self) -> dict[str, Any]:
        """As verdict.json holds it."""
        listed = [asdict(channel) for channel in self.channels]
        observer = [asdict(channel) for channel in self.observer]
        return {"channels": listed, "observer": observer, "strange": self.strange, "silent": self.silent}


def audit(places: Sequence[Place], event: Mapping[str, Any], observed: Mapping[str, Any] | None = None) -> Audit:
    """What the processes counted, as the plant's event `heard` tells it, and what the observer counted itself.

    Who did not say a last word has died or hangs, and what it said before is not known; a process in its second life
    knows only what it said and heard in that.
    """
    words = {keys.PLANT: event["plant"]}
    lives = {keys.PLANT: 0}
    if observed is not None:
        words[OBSERVER], lives[OBSERVER] = observed, 0
    for place, word in zip(places, event["shards"], strict=True):
        if is_counted(word) and isinstance(word.get("life"), int):
            words[place.name], lives[place.name] = word, word["life"]
    counted, observer = ([_counted(one, words, lives) for one in some] for some in (channels(places), OBSERVED))
    strange = {name: _shortened(word["strange"]) for name, word in words.items() if word["strange"]}
    return Audit(counted, strange, [place.name for place in places if place.name not in words], observer)


def observed(seen: Sender, receiver: Receiver, inbox: Inbox) -> dict[str, Any]:
    """What the observer said and heard until the plant told its own counts, as an agent's last word holds it."""
    refused = {receiver.key: inbox.refused} if inbox.refused else {}
    heard = {receiver.key: inbox.arrived_at_event}
    return {"said": {seen.key: seen.said}, "heard": heard, "refused": refused, "strange": receiver.strange}


STRANGE_KEYS = 16
"""strange keys of one process that a verdict names"""
_LARGEST_COUNT = 2**63 - 1


def _shortened(strange: Mapping[str, int]) -> dict[str, int]:
    """Return the first 16 keys of nobody, each in at most 80 characters, and the others as one sum.

    An agent's last word is the text of another machine: it can hold any number of keys of any length.
    """
    found: dict[str, int] = {}
    for k, (key, number) in enumerate(strange.items()):
        name = shorten(key) if k < STRANGE_KEYS else f"{len(strange) - STRANGE_KEYS} more keys"
        found[name] = max(-1, min(found.get(name, 0) + number, _LARGEST_COUNT))
    return found


def _counted(one: Channel, words: Mapping[str, Any], lives: Mapping[str, int]) -> Channel:
    """Return a channel with the counts of both ends."""
    heard = words.get(one.listener)
    return Channel(
        one.key,
        one.speaker,
        one.listener,
        words[one.speaker]["said"].get(one.key) if lives.get(one.speaker) == 0 else None,
        None if heard is None else heard["heard"].get(one.key),
        None if heard is None else heard["refused"].get(one.key, 0),
    )


def is_counted(word: Any) -> bool:
    """Return True if `word`, which came over the wire, is what a process says at its end."""
    tables = [word.get(name) for name in ("said", "heard", "refused", "strange")] if isinstance(word, dict) else [None]
    return all(
        isinstance(table, dict) and all(isinstance(number, int) for number in table.values()) for table in tables
    )
