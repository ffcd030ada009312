"""From the plant to the observer: batches of messages, of which none is lost, none comes twice, and all in order."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable, Sequence

from hedgerow.wire.codec import Buffer, Kind, MessageError, decode_batch, encode_batch, join, kind_of, telemetry_bytes

REPEAT_AFTER_S = 2.0
"""What the observer has not taken in for so long is sent again."""
REPEAT_MOST = 1024
"""batches at a time"""
TOGETHER_S = 0.05
"""What need not be sent at once leaves once nothing has for so long: to send a row, and to hear it, costs time."""
AHEAD_BYTES, AHEAD_ROWS = 32 * 2**20, 4096
"""How much telemetry the plant may send before the observer has taken it in; it bounds the memory of both."""


def rows_ahead(n: int, e: int) -> int:
    """How many rows of telemetry the plant may send before the observer has taken them in."""
    return max(2, min(AHEAD_ROWS, AHEAD_BYTES // telemetry_bytes(n, e)))


class Outbox:
    """The sender's end: keeps what was sent until the receiver says that it has it. Not thread-safe."""

    def __init__(self, put: Callable[[bytes], None]) -> None:
        self._put = put
        self.said = 0
        """how many batches were sent, repetitions included"""
        self._next = 0
        self._sent_at = self._repeated_at = 0.0
        self._waiting: list[tuple[bytes]] = []
        """messages of the next batch"""
        self._unseen: deque[tuple[int, bytes]] = deque()
        """batches, each with how many messages it has"""
        self._count = 0
        self.progress_at = time.monotonic()
        """when the receiver last took something in, or had nothing to take"""

    def __len__(self) -> int:
        """How many messages the receiver has not taken in."""
        return self._count

    def send(self, *message: Buffer) -> None:
        """Send the next message, in its parts, and before it all that waits."""
        self._add()
        self._send(message)

    def send_soon(self, *message: Buffer) -> None:
        """Send the next message, together with those before and after it if the last batch left a moment ago."""
        self._add()
        self._waiting.append((join(message),))
        if time.monotonic() - self._sent_at >= TOGETHER_S:
            self._send()

    def _add(self) -> None:
        if not self._count:
            self.progress_at = time.monotonic()
        self._count += 1

    def _send(self, *last: Sequence[Buffer]) -> None:
        messages = (*self._waiting, *last)
        whole = encode_batch(self._next, messages)
        self._unseen.append((len(messages), whole))
        self._next += 1
        self._waiting.clear()
        self._sent_at = time.monotonic()
        self.said += 1
        self._put(whole)

    def seen(self, number: int) -> None:
        """The receiver has all batches up to this one."""
        while self._unseen and self._next - len(self._unseen) <= number:
            self._count -= self._unseen.popleft()[0]
            self.progress_at = time.monotonic()

    def tend(self) -> None:
        """Send what waits, and again what should have been taken in long ago."""
        now = time.monotonic()
        if self._waiting and now - self._sent_at >= TOGETHER_S:
            self._send()
        if self._unseen and now - max(self.progress_at, self._repeated_at) > REPEAT_AFTER_S:
            self._repeated_at = now
            self.repeat()

    def repeat(self) -> None:
        """Send all again that the receiver has not taken in: from some batch on the wire lost them all."""
        for _, whole in itertools.islice(self._unseen, REPEAT_MOST):
            self.said += 1
            self._put(whole)


class Inbox:
    """The receiver's end: takes the next batch and no other; the rest comes again."""

    def __init__(self) -> None:
        self._messages: deque[bytes] = deque()
        self.last = -1
        """the number of the last batch taken"""
        self.refused = 0
        self.arrived = 0
        """how many batches came, in their order or not"""
        self.arrived_at_event = 0
        """the same, up to the last batch that ends with an event"""

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, whole: bytes) -> list[bytes]:
        """Take a batch as it came, on the network thread; its messages, or none if it is not the next."""
        try:
            number, messages = decode_batch(whole)
        except MessageError:
            self.refused += 1
            return []
        self.arrived += 1
        if number != self.last + 1:
            return []
        self._messages += messages
        self.last = number
        if messages and kind_of(messages[-1]) == Kind.EVENT:
            self.arrived_at_event = self.arrived
        return messages

    def drain(self) -> list[bytes]:
        """All that was taken since the last time."""
        return [self._messages.popleft() for _ in range(len(self._messages))]
