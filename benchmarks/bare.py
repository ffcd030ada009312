"""The floor: as many messages over Zenoh as paper7 has, of the same length, without any other work.

There are no law, no dynamics, no checks, no deadlines and no telemetry. Processes wake each other up in lockstep over
the same keys, sessions and router, with constant payloads. The result is the cost of Zenoh and the kernel.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from hedgerow.wire import keys
from hedgerow.wire.message import REPORT_ROWS
from hedgerow.wire.runtime import one_network_thread, runtime_environment, share_the_cores
from hedgerow.wire.session import open_client, open_router, publisher, subscriber, wait_for_listeners

HEADER = 16
STEP = struct.Struct("<q")
STOP = -1
Edges = list[tuple[int, int]]


def _stamp(t: int, body: int) -> bytes:
    return bytes(8) + STEP.pack(t) + bytes(body)


def _step(message: bytes) -> int:
    return int(STEP.unpack_from(message, 8)[0])


def agent(endpoint: str, me: int, neighbours: list[int]) -> None:
    """Answer state(t) once every neighbour's link(t - 1) is here."""
    done, heard = threading.Event(), dict.fromkeys((-1,), len(neighbours))
    waiting: list[int] = []

    def go() -> None:
        t = waiting[0]
        if heard.get(t - 1, 0) < len(neighbours):
            return
        heard.pop(t - 1, None)
        waiting.clear()
        for link in links:
            link.put(_stamp(t, 24))
        inputs.put(_stamp(t, 8 * (1 + REPORT_ROWS)))

    def on_state(message: bytes) -> None:
        t = _step(message)
        if t == STOP:
            done.set()
            return
        waiting.append(t)
        go()

    def on_link(message: bytes) -> None:
        t = _step(message)
        heard[t] = heard.get(t, 0) + 1
        if waiting:
            go()

    one_network_thread()
    with open_client(endpoint, "bare") as session:
        subscribers = [subscriber(session, keys.link(neighbour, me), on_link) for neighbour in neighbours]
        subscribers.append(subscriber(session, keys.state(me), on_state))
        inputs = publisher(session, keys.input_(me))
        links = [publisher(session, keys.link(me, neighbour)) for neighbour in neighbours]
        wait_for_listeners([inputs, *links])
        token = session.liveliness().declare_token(keys.alive(str(me)))
        done.wait()
        del token


def plant(endpoint: str, n: int, steps: int) -> float:
    """Send states, wait for every input, `steps` times; return steps per second."""
    done, arrived = threading.Event(), 0
    t = 0

    def send() -> None:
        for state in states:
            state.put(_stamp(t, 8))

    def on_input(_: bytes) -> None:
        nonlocal arrived, t
        arrived += 1
        if arrived < n:
            return
        arrived, t = 0, t + 1
        if t == steps:
            done.set()
        else:
            send()
        telemetry.put(_stamp(t, 8 + 8 * n * (3 + REPORT_ROWS)))

    with open_router(endpoint, "bare") as session:
        telemetry = publisher(session, keys.TELEMETRY)
        states = [publisher(session, keys.state(i)) for i in range(n)]
        inputs = [subscriber(session, keys.input_(i), on_input) for i in range(n)]
        wait_for_listeners([telemetry, *states])
        while len(list(session.liveliness().get(keys.ALIVE))) < n:
            pass
        began = time.perf_counter()
        send()
        done.wait()
        elapsed = time.perf_counter() - began
        del inputs
        for state in states:
            state.put(_stamp(STOP, 0))
        return steps / elapsed


def run(n: int, edges: Edges, steps: int) -> float:
    """Return the steps per second of the bare loop on this machine now."""
    neighbours = [[b if a == i else a for a, b in edges if i in (a, b)] for i in range(n)]
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder, contextlib.ExitStack() as stack:
        endpoint = f"unixsock-stream/{Path(folder) / 'router.sock'}"
        environment = os.environ | runtime_environment()
        base = [sys.executable, "-m", "benchmarks.bare", endpoint]
        agents = [
            subprocess.Popen([*base, "agent", str(i), *map(str, neighbours[i])], env=environment) for i in range(n)
        ]
        command = [*base, "plant", str(n), str(steps)]
        plant = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        observer = stack.enter_context(open_client(endpoint, "bare"))
        stack.enter_context(subscriber(observer, keys.TELEMETRY, lambda _: None))
        output, _ = plant.communicate(timeout=60)
        for process in agents:
            process.wait(30)
        return float(output)


def main() -> None:
    """Run one process of the loop: `ENDPOINT agent ME NEIGHBOUR…` or `ENDPOINT plant N STEPS`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("role", choices=["agent", "plant"])
    parser.add_argument("numbers", type=int, nargs="+")
    known = parser.parse_args()
    first, *rest = known.numbers
    share_the_cores()
    if known.role == "agent":
        agent(known.endpoint, first, rest)
    else:
        print(plant(known.endpoint, first, rest[0]))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
