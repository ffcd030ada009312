"""Sessions: the waits, and their limits."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from hedgerow.topologies.errors import DeadlineError
from hedgerow.wire.session import open_client, open_router, publisher, wait_for_listeners


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
