"""Zenoh by hand: the same sessions, keys and router as ours, and only the loop.

There is one more process than in the others: a router, as in ours. The plant and the agents answer on Zenoh's own
thread. (`benchmarks/bare.py` is the floor below: it has no law and no plant.)
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import tempfile
import threading
from functools import partial

from benchmarks.peers.network import MESSAGE, PLANT, STOP, Agent, Done, Lockstep, Network, Plant
from hedgerow.wire import keys
from hedgerow.wire.runtime import one_network_thread, runtime_environment
from hedgerow.wire.session import open_client, open_router, publisher, subscriber, wait_for_listeners

RUN = "peers"


def _router(endpoint: str, up: threading.Event) -> None:
    with open_router(endpoint):
        up.set()
        threading.Event().wait()


def _agent(network: Network, me: int, endpoint: str) -> None:
    agent = Agent(network, me)
    lockstep = Lockstep(agent)
    stopped = threading.Event()

    def take(message: bytes) -> None:
        sender, t, x, u = MESSAGE.unpack(message)
        if t == STOP:
            stopped.set()
            return
        if (answer := lockstep.take(sender, t, x, u)) is not None:
            message = MESSAGE.pack(me, *answer)
            for out in outs:
                out.put(message)

    one_network_thread()
    with open_client(endpoint, RUN) as session:
        listening = [subscriber(session, keys.link(j, me), take) for j in agent.neighbours]
        listening.append(subscriber(session, keys.state(me), take))
        outs = [publisher(session, keys.link(me, j)) for j in agent.neighbours]
        outs.append(publisher(session, keys.input_(me)))
        wait_for_listeners(outs)
        token = session.liveliness().declare_token(keys.alive(str(me)))
        stopped.wait()
        del token, listening


def run(network: Network, steps: int) -> Done:
    """Run with the plant in this process."""
    os.environ.update(runtime_environment())
    plant, n = Plant(network, steps), len(network)
    fork = multiprocessing.get_context("fork")
    ended, here, u = threading.Event(), 0, [0.0] * n

    def send() -> None:
        for out, x in zip(outs, plant.x.tolist(), strict=True):
            out.put(MESSAGE.pack(PLANT, plant.t, x, 0.0))

    def take(message: bytes) -> None:
        nonlocal here
        sender, _, _, u[sender] = MESSAGE.unpack(message)
        here += 1
        if here == n:
            here = 0
            if plant.step(u):
                send()
            else:
                ended.set()

    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder, contextlib.ExitStack() as stack:
        endpoint = f"unixsock-stream/{folder}/router.sock"
        up = fork.Event()
        router = fork.Process(target=_router, args=(endpoint, up), daemon=True)
        router.start()
        up.wait()
        agents = [fork.Process(target=_agent, args=(network, i, endpoint), daemon=True) for i in range(n)]
        for agent in agents:
            agent.start()
        session = stack.enter_context(open_client(endpoint, RUN))
        outs = [publisher(session, keys.state(i)) for i in range(n)]
        listening = [subscriber(session, keys.input_(i), partial(take)) for i in range(n)]
        wait_for_listeners(outs)
        while len(list(session.liveliness().get(keys.ALIVE))) < n:
            pass
        send()
        ended.wait()
        done = plant.done()
        for out in outs:
            out.put(MESSAGE.pack(PLANT, STOP, 0.0, 0.0))
        for agent in agents:
            agent.join()
        del listening
        router.terminate()
        return done
