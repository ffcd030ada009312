"""A bounded queue between two threads; when it is full, the sender waits or the oldest items are dropped."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BoundedQueue(Generic[Item]):
    """Items with sizes in bytes, bounded in number and in total size; one item is always accepted."""

    def __init__(self, most: int, most_bytes: int) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._items: deque[tuple[Item, int]] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self.bytes = 0
        """the total size of the queued items [bytes]"""

    def put(self, item: Item, size: int = 0, timeout_s: float | None = None) -> bool:
        """Wait for room and append an item; return False if there is no room in time."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._items or self._has_room(size), timeout_s):
                return False
            self._append(item, size)
            return True

    def put_or_drop(self, item: Item, size: int) -> int:
        """Append an item without waiting; drop the oldest items beyond the bounds, and return how many."""
        dropped = 0
        with self._changed:
            while self._items and not self._has_room(size):
                self._pop()
                dropped += 1
            self._append(item, size)
        return dropped

    def put_back(self, item: Item, size: int) -> None:
        """Put an item that was taken in front of the others again."""
        with self._changed:
            self._items.appendleft((item, size))
            self.bytes += size

    def take(self) -> tuple[Item, int] | None:
        """Wait for the oldest item, and return it with its size; None once the queue is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            return self._pop() if self._items else None

    def close(self) -> None:
        """End `take` once the queue is empty; no item may come afterwards."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> int:
        """Remove all items, and return how many there were."""
        with self._changed:
            dropped = len(self._items)
            while self._items:
                self._pop()
        return dropped

    def _has_room(self, size: int) -> bool:
        return len(self._items) < self._most and self.bytes + size <= self._most_bytes

    def _append(self, item: Item, size: int) -> None:
        self._items.append((item, size))
        self.bytes += size
        self._changed.notify_all()

    def _pop(self) -> tuple[Item, int]:
        item, size = self._items.popleft()
        self.bytes -= size
        self._changed.notify_all()
        return item, size
