"""Sessions: the waits, and their limits."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from hedgerow.topologies.errors import DeadlineError
from hedgerow.wire.session import Receiver, Sender, open_client, open_router, publisher, wait_for_listeners


def test_listeners_that_come_one_after_another_have_one_deadline(tmp_path: Path) -> None:
    """Each arrives within the time limit of one, and the last long after it."""
    endpoint = f"unixsock-stream/{tmp_path}/s"
    over, listening = threading.Event(), []
    with open_router(endpoint, "here") as router, open_client(endpoint, "here") as client:
        publishers = [publisher(router, f"key/{k}") for k in range(5)]

        def come() -> None:
            for one in publishers:
                if over.wait(0.8):
                    return
                listening.append(client.declare_subscriber(one.key_expr, lambda _: None))

        coming = threading.Thread(target=come)
        coming.start()
        try:
            with pytest.raises(DeadlineError):
                wait_for_listeners(publishers, 1.0)
        finally:
            over.set()
            coming.join()
        for one in publishers:
            listening.append(client.declare_subscriber(one.key_expr, lambda _: None))
        wait_for_listeners(publishers)


def test_equal_messages_in_a_row_count_once_at_both_ends(tmp_path: Path) -> None:
    """Zenoh may deliver each message twice, and an agent repeats its messages."""
    endpoint = f"unixsock-stream/{tmp_path}/s"
    arrived, done = list[bytes](), threading.Event()

    def take(message: bytes) -> None:
        arrived.append(message)
        if message == b"last":
            done.set()

    with open_router(endpoint, "here") as router, open_client(endpoint, "here") as client:
        receiver, once, twice = Receiver(client, "key", take), Sender(router, "key"), publisher(router, "key")
        wait_for_listeners([twice])
        for message in (b"a", b"b", b"b", b"a", b"last"):
            once.put(message)
            twice.put(message)
        assert done.wait(10.0)
        closed = receiver.received
    assert arrived[:4] == [b"a", b"a", b"b", b"b"]
    assert once.sent == 4
    assert closed in (3, 4), "the last one counts after its callback"
