"""From the plant to the observer: numbered messages, of which none is lost, none comes twice, and all in order."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable

from wire.codec import Buffer, MessageError, numbered, read_number, telemetry_bytes

REPEAT_AFTER_S = 2.0
"""What the observer has not taken in for so long is sent again."""
REPEAT_MOST = 1024
"""messages at a time"""
AHEAD_BYTES, AHEAD_ROWS = 32 * 2**20, 4096
"""How much telemetry the plant may send before the observer has taken it in; it bounds the memory of both."""


def rows_ahead(n: int, e: int) -> int:
    """How many rows of telemetry the plant may send before the observer has taken them in."""
    return max(2, min(AHEAD_ROWS, AHEAD_BYTES // telemetry_bytes(n, e)))


class Outbox:
    """The sender's end: keeps what was sent until the receiver says that it has it. Not thread-safe."""

    def __init__(self, put: Callable[[bytes], None]) -> None:
        self._put = put
        self._next = 0
        self._repeated_at = 0.0
        self._unseen: deque[bytes] = deque()
        self.progress_at = time.monotonic()
        """when the receiver last took something in, or had nothing to take"""

    def __len__(self) -> int:
        """How many messages the receiver has not taken in."""
        return len(self._unseen)

    def send(self, *message: Buffer) -> None:
        """Send the next message, in its parts."""
        if not self._unseen:
            self.progress_at = time.monotonic()
        whole = numbered(self._next, *message)
        self._next += 1
        self._unseen.append(whole)
        self._put(whole)

    def seen(self, number: int) -> None:
        """The receiver has all messages up to this one."""
        while self._unseen and self._next - len(self._unseen) <= number:
            self._unseen.popleft()
            self.progress_at = time.monotonic()

    def repeat_if_due(self) -> None:
        """Send again what should have been taken in long ago."""
        if self._unseen and time.monotonic() - max(self.progress_at, self._repeated_at) > REPEAT_AFTER_S:
            self._repeated_at = time.monotonic()
            self.repeat()

    def repeat(self) -> None:
        """Send all again that the receiver has not taken in: from some message on the wire lost them all."""
        for whole in itertools.islice(self._unseen, REPEAT_MOST):
            self._put(whole)


class Inbox:
    """The receiver's end: takes the next message and no other; the rest comes again."""

    def __init__(self) -> None:
        self._messages: deque[bytes] = deque()
        self.last = -1
        """the number of the last message taken"""
        self.refused = 0

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, whole: bytes) -> bytes | None:
        """Take a message as it came, on the network thread; it, or None if it is not the next."""
        try:
            number, message = read_number(whole)
        except MessageError:
            self.refused += 1
            return None
        if number != self.last + 1:
            return None
        self._messages.append(message)
        self.last = number
        return message

    def drain(self) -> list[bytes]:
        """All that was taken since the last time."""
        return [self._messages.popleft() for _ in range(len(self._messages))]
