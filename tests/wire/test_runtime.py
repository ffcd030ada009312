"""The threads of Zenoh in the plant, which is the router of a run."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

from hedgerow.wire.runtime import runtime_environment
from hedgerow.wire.session import open_client, publisher, subscriber, wait_for_listeners

ROUTER = """
import sys
from hedgerow.wire.session import open_router
with open_router(sys.argv[1]):
    print("open", flush=True)
    sys.stdin.read()
"""
LONG_BYTES = 4 * 2**20
"""more than the queue of Zenoh (128 kB) and the buffers of the sockets hold together"""
DEADLINE_S = 30.0


def test_the_router_passes_on_messages_that_neither_its_queue_nor_the_sockets_hold(tmp_path: Path) -> None:
    """The thread that waits for the socket must not be the one that notices that the socket takes more."""
    endpoint = f"unixsock-stream/{tmp_path / 'router.sock'}"
    received, all_here = list[int](), threading.Event()

    def take(message: bytes) -> None:
        received.append(len(message))
        if len(received) == 8:
            all_here.set()

    command, environment = [sys.executable, "-c", ROUTER, endpoint], os.environ | runtime_environment()
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as router:
        assert router.stdin is not None
        assert router.stdout is not None
        try:
            assert router.stdout.readline() == "open\n"
            with open_client(endpoint, "run") as one, open_client(endpoint, "run") as other:
                there, back = subscriber(other, "there", take), subscriber(one, "back", take)
                senders = [publisher(one, "there"), publisher(other, "back")]
                wait_for_listeners(senders)
                for _ in range(4):  # in both directions at once
                    for sender in senders:
                        sender.put(bytes(LONG_BYTES))
                assert all_here.wait(DEADLINE_S), f"{len(received)} of 8 messages"
                assert set(received) == {LONG_BYTES}
                del there, back
        finally:
            router.stdin.close()
