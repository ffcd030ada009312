"""Another shard with neighbours of ours, and its link messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from hedgerow.topologies.graph import Index
from hedgerow.wire.codec import decode_link
from hedgerow.wire.message import Link

MAIL = 64
"""number of link messages kept per peer; a correct peer is never this far ahead"""


@dataclass(eq=False, slots=True)
class Peer:
    """Another shard with neighbours of ours, and its link messages."""

    nodes: Index | None
    """indices of our nodes in a link message to it; None for all nodes in order"""
    sends: int
    """number of these nodes"""
    receives: int
    """number of its nodes in a message to us"""
    start: int
    """the place of its first input in our own inputs followed by the peers' inputs"""
    incidences: Sequence[int]
    """the incidences that lead to it"""
    mail: dict[int, Link | bytes] = field(default_factory=dict)
    """link messages by step, as they arrived, for steps not yet used by a sample"""

    def keep(self, t: int, link: Link | bytes) -> None:
        """Keep a message of step t; if there are too many, drop the one of the latest step."""
        self.mail[t] = link
        if len(self.mail) > MAIL:
            del self.mail[max(self.mail)]

    def take(self, t: int) -> Link | None:
        """Return the link message of step t and drop it; None if it has not arrived."""
        link = self.mail.pop(t, None)
        return decode_link(link, self.receives) if isinstance(link, bytes) else link
