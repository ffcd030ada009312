"""pyzmq by hand: one PULL socket per process, and a PUSH socket for each receiver, over ipc.

Processes are forked from the plant before it creates its context.
"""

from __future__ import annotations

import multiprocessing
import tempfile

import zmq

from benchmarks.peers.network import MESSAGE, PLANT, STOP, Agent, Done, Lockstep, Network, Plant

Socket = zmq.Socket[bytes]


def _pull(context: zmq.Context[Socket], folder: str, me: int) -> Socket:
    end = context.socket(zmq.PULL)
    end.bind(f"ipc://{folder}/{me}")
    return end


def _push(context: zmq.Context[Socket], folder: str, other: int) -> Socket:
    end = context.socket(zmq.PUSH)
    end.connect(f"ipc://{folder}/{other}")
    return end


def _agent(network: Network, me: int, folder: str) -> None:
    context = zmq.Context()
    agent = Agent(network, me)
    lockstep = Lockstep(agent)
    inbox = _pull(context, folder, me)
    others = [_push(context, folder, other) for other in (*agent.neighbours, PLANT)]
    while True:
        sender, t, x, u = MESSAGE.unpack(inbox.recv())
        if t == STOP:
            context.destroy(linger=0)
            return
        if (answer := lockstep.take(sender, t, x, u)) is not None:
            message = MESSAGE.pack(me, *answer)
            for other in others:
                other.send(message)


def run(network: Network, steps: int) -> Done:
    """Run with the plant in this process."""
    plant, n = Plant(network, steps), len(network)
    fork = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory(prefix="hedgerow-") as folder:
        agents = [fork.Process(target=_agent, args=(network, i, folder), daemon=True) for i in range(n)]
        for agent in agents:
            agent.start()
        context = zmq.Context()
        inbox = _pull(context, folder, PLANT)
        outs = [_push(context, folder, i) for i in range(n)]
        u = [0.0] * n
        going = True
        while going:
            t = plant.t
            for out, x in zip(outs, plant.x.tolist(), strict=True):
                out.send(MESSAGE.pack(PLANT, t, x, 0.0))
            for _ in range(n):
                sender, _, _, value = MESSAGE.unpack(inbox.recv())
                u[sender] = value
            going = plant.step(u)
        done = plant.done()
        for out in outs:
            out.send(MESSAGE.pack(PLANT, STOP, 0.0, 0.0))
        for agent in agents:
            agent.join()
        context.destroy(linger=0)
        return done
