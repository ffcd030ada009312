"""The bounded queue: what each side waits for, what is dropped, and what is counted."""

from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.ground.bounded_queue import BoundedQueue


@given(st.lists(st.integers(0, 9), max_size=30), st.integers(1, 5), st.integers(1, 20))
def test_the_newest_items_within_the_bounds_stay(sizes: list[int], most: int, most_bytes: int) -> None:
    queue: BoundedQueue[int] = BoundedQueue(most, most_bytes)
    dropped = sum(queue.put_or_drop(k, size) for k, size in enumerate(sizes))
    queue.close()
    left = list(iter(queue.take, None))
    assert [size for _, size in left] == sizes[dropped:]
    assert len(left) <= most
    assert len(left) == bool(sizes) or sum(sizes[dropped:]) <= most_bytes
    assert queue.bytes == 0


def test_a_sender_waits_for_room_and_a_taker_for_an_item() -> None:
    queue: BoundedQueue[int] = BoundedQueue(2, 100)
    taken: list[int] = []

    def take() -> None:
        taken.extend(item for item, _ in iter(queue.take, None))

    taker = threading.Thread(target=take)
    taker.start()
    for k in range(50):
        queue.put(k, 60)
    queue.close()
    taker.join()
    assert taken == list(range(50))


def test_an_item_that_came_back_is_the_next() -> None:
    queue: BoundedQueue[str] = BoundedQueue(9, 9)
    for item in "ab":
        queue.put(item, 1)
    queue.put_back(*queue.take() or ("", 0))
    assert queue.take() == ("a", 1)
    assert queue.clear() == 1
