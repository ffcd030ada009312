"""The stream from the plant to the observer: batches of messages, each received exactly once and in order.

A batch that is sent or delivered several times counts once at both ends.
"""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable, Sequence

from hedgerow.wire.codec import decode_batch, encode_batch, join, kind_of, telemetry_bytes
from hedgerow.wire.message import Buffer, Kind, MessageError

REPEAT_AFTER_S = 2.0
"""Batches that the observer has not acknowledged for this time are sent again [s]."""
REPEAT_MOST = 1024
"""The maximum number of batches that are sent again at a time."""
TOGETHER_S = 0.05
"""A message that can wait leaves when no batch has left for this time [s].

Each batch costs time to send and to receive.
"""
AHEAD_BYTES, AHEAD_ROWS = 32 * 2**20, 4096
"""The maximum amount of telemetry that the plant sends before the observer acknowledges it.

It bounds the memory of both.
"""

KNOWN_BATCHES = 2 * AHEAD_ROWS
"""The number of batches whose copies are recognised: more than the plant sends before an acknowledgement."""


def rows_ahead(n: int, e: int) -> int:
    """Return the maximum number of rows of telemetry that the plant may send before the observer acknowledges them."""
    return max(2, min(AHEAD_ROWS, AHEAD_BYTES // telemetry_bytes(n, e)))


class Outbox:
    """The sender's end. It stores each batch until the receiver acknowledges it. Not thread-safe."""

    def __init__(self, put: Callable[[bytes], None], most_waiting: int = AHEAD_ROWS) -> None:
        """`most_waiting` is the number of queued messages that leave at once."""
        self._put, self._most_waiting = put, most_waiting
        self.sent = 0
        """the number of batches sent, repetitions not included"""
        self._sent_at = self._repeated_at = 0.0
        self._waiting: list[tuple[bytes]] = []
        """messages of the next batch"""
        self._unseen: deque[tuple[int, bytes]] = deque()
        """batches, each with the number of its messages"""
        self._count = 0
        self.progress_at = time.monotonic()
        """the time when the receiver last made progress, or had nothing to receive"""

    def __len__(self) -> int:
        """Return the number of messages that the receiver has not acknowledged."""
        return self._count

    def send(self, *message: Buffer) -> None:
        """Send the next message, in its parts, after all queued messages."""
        self._add()
        self._send(message)

    def send_soon(self, *message: Buffer) -> None:
        """Send the next message; queue it if the last batch left a moment ago, so that messages share a batch."""
        self._add()
        self._waiting.append((join(message),))
        if len(self._waiting) >= self._most_waiting or time.monotonic() - self._sent_at >= TOGETHER_S:
            self._send()

    def _add(self) -> None:
        if not self._count:
            self.progress_at = time.monotonic()
        self._count += 1

    def _send(self, *last: Sequence[Buffer]) -> None:
        messages = (*self._waiting, *last)
        whole = encode_batch(self.sent, messages)
        self._unseen.append((len(messages), whole))
        self.sent += 1
        self._waiting.clear()
        self._sent_at = time.monotonic()
        self._put(whole)

    def seen(self, number: int) -> None:
        """Forget the batches up to this one, which the receiver acknowledged."""
        while self._unseen and self.sent - len(self._unseen) <= number:
            self._count -= self._unseen.popleft()[0]
            self.progress_at = time.monotonic()

    def tend(self) -> None:
        """Send the queued messages, and repeat batches that were not acknowledged in time."""
        now = time.monotonic()
        if self._waiting and now - self._sent_at >= TOGETHER_S:
            self._send()
        if self._unseen and now - max(self.progress_at, self._repeated_at) > REPEAT_AFTER_S:
            self._repeated_at = now
            self.repeat()

    def repeat(self) -> None:
        """Send all batches again that the receiver has not acknowledged."""
        for _, whole in itertools.islice(self._unseen, REPEAT_MOST):
            self._put(whole)


class Inbox:
    """The receiver's end. It accepts only the next batch; the sender repeats the others."""

    def __init__(self, look_up: Callable[[bytes], bytes] | None = None) -> None:
        """`look_up` returns a copy of the row that a PLACE message names; without it, such a message is refused."""
        self._look_up = look_up
        self._messages: deque[bytes] = deque()
        self.last = -1
        """the number of the last batch accepted"""
        self.refused = 0
        self.arrived = 0
        """the number of different batches that arrived, in order or not"""
        self._known: dict[int, None] = {}
        """the hashes of the last different batches, the oldest first"""
        self.arrived_at_event = 0
        """the number of batches up to the last one that ends with an event"""

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, whole: bytes) -> list[bytes]:
        """Accept a batch on the network thread; return its messages, or an empty list if it is not the next batch."""
        try:
            number, messages = decode_batch(whole)
        except MessageError:
            self.refused += 1
            return []
        self._count(hash(whole))
        if number != self.last + 1:
            return []
        if any(kind_of(message) == Kind.PLACE for message in messages):
            # Copy now: the plant may overwrite a row that we have acknowledged.
            try:
                messages = [self._row(one) if kind_of(one) == Kind.PLACE else one for one in messages]
            except MessageError:
                self.refused += 1
                return []
        self._messages += messages
        self.last = number
        if messages and kind_of(messages[-1]) == Kind.EVENT:
            self.arrived_at_event = self.arrived
        return messages

    def _count(self, batch: int) -> None:
        """Count a batch, by its hash, unless it arrived before.

        A copy is no evidence of an intruder: the plant repeats batches, and Zenoh sometimes delivers them twice.
        Another batch with the same number is evidence.
        """
        if batch in self._known:
            return
        self.arrived += 1
        self._known[batch] = None
        if len(self._known) > KNOWN_BATCHES:
            del self._known[next(iter(self._known))]

    def _row(self, message: bytes) -> bytes:
        if self._look_up is None:
            raise MessageError("a row in shared memory, and there is none")
        row = self._look_up(message)
        if kind_of(row) != Kind.TELEMETRY:
            raise MessageError("the shared memory holds no telemetry there")
        return row

    def drain(self) -> list[bytes]:
        """Return all messages that were accepted since the last call."""
        return [self._messages.popleft() for _ in range(len(self._messages))]
