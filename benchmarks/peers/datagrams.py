"""Unix datagrams by hand: one socket per process, messages straight from agent to agent.

A datagram is sent, or the sender waits, so nothing is lost. There is no circular wait, because the plant always reads
and an agent has at most two unread messages of each neighbour. Processes are forked from the plant.
"""

from __future__ import annotations

import multiprocessing
import socket
import tempfile

from benchmarks.peers.network import MESSAGE, PLANT, STOP, Agent, Done, Lockstep, Network, Plant


def _bound(folder: str, me: int) -> socket.socket:
    end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    end.bind(f"{folder}/{me}")
    return end


def _to(folder: str, other: int) -> socket.socket:
    end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    end.connect(f"{folder}/{other}")
    return end


def _agent(network: Network, me: int, end: socket.socket, folder: str) -> None:
    agent = Agent(network, me)
    lockstep = Lockstep(agent)
    others = [_to(folder, other) for other in (*agent.neighbours, PLANT)]
    while True:
        sender, t, x, u = MESSAGE.unpack(end.recv(MESSAGE.size))
        if t == STOP:
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
        inbox = _bound(folder, PLANT)
        ends = [_bound(folder, i) for i in range(n)]
        for i, end in enumerate(ends):
            fork.Process(target=_agent, args=(network, i, end, folder), daemon=True).start()
        outs = [_to(folder, i) for i in range(n)]
        u = [0.0] * n
        going = True
        while going:
            t = plant.t
            for out, x in zip(outs, plant.x.tolist(), strict=True):
                out.send(MESSAGE.pack(PLANT, t, x, 0.0))
            for _ in range(n):
                sender, _, _, value = MESSAGE.unpack(inbox.recv(MESSAGE.size))
                u[sender] = value
            going = plant.step(u)
        done = plant.done()
        for out in outs:
            out.send(MESSAGE.pack(PLANT, STOP, 0.0, 0.0))
        return done
