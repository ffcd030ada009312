"""mango: one TCP container with one agent per process, messages straight from container to container.

Messages are pickled, which is faster than mango's JSON. Processes are forked from the plant's.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import pickle
import socket
from collections.abc import Sequence
from threading import Barrier
from typing import Any

import mango
from mango.messages.codecs import Codec

from benchmarks.peers.network import PLANT, STOP, Agent, Done, Lockstep, Network, Plant

NAME = "node"
"""the name of the one agent of a container"""
Message = tuple[int, int, float, float]


class Pickle(Codec):
    """The codec of messages: Python's pickle."""

    def encode(self, data: Any) -> bytes:
        """Return the bytes of a message."""
        return pickle.dumps(data, protocol=pickle.HIGHEST_PROTOCOL)

    def decode(self, data: bytes) -> Any:
        """Return the message in bytes."""
        return pickle.loads(data)


class Inbox(mango.Agent):
    """The queue of received messages."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: asyncio.Queue[Message] = asyncio.Queue()

    def handle_message(self, content: Message, meta: dict[str, Any]) -> None:  # noqa: ARG002  (mango asks for the name)
        """Store a message."""
        self.messages.put_nowait(content)


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context(socket.socket()) for _ in range(count)]
        for end in ends:
            end.bind(("127.0.0.1", 0))
        return [int(end.getsockname()[1]) for end in ends]


def _address(port: int) -> Any:
    return mango.AgentAddress(("127.0.0.1", port), NAME)


async def _agent(network: Network, me: int, ports: Sequence[int], here: Barrier) -> None:
    agent = Agent(network, me)
    lockstep = Lockstep(agent)
    container = mango.create_tcp_container(("127.0.0.1", ports[me]), codec=Pickle())
    inbox = container.register(Inbox(), suggested_aid=NAME)
    others = [_address(ports[other]) for other in (*agent.neighbours, PLANT)]
    async with mango.activate(container):
        here.wait()
        while True:
            sender, t, x, u = await inbox.messages.get()
            if t == STOP:
                return
            if (answer := lockstep.take(sender, t, x, u)) is not None:
                for other in others:
                    await inbox.send_message((me, *answer), other)


async def _plant(network: Network, steps: int, ports: Sequence[int], here: Barrier) -> Done:
    plant, n = Plant(network, steps), len(network)
    container = mango.create_tcp_container(("127.0.0.1", ports[PLANT]), codec=Pickle())
    inbox = container.register(Inbox(), suggested_aid=NAME)
    agents = [_address(port) for port in ports[:n]]
    u, going = [0.0] * n, True
    async with mango.activate(container):
        here.wait()
        while going:
            for agent, x in zip(agents, plant.x.tolist(), strict=True):
                await inbox.send_message((PLANT, plant.t, x, 0.0), agent)
            for _ in range(n):
                sender, _, _, value = await inbox.messages.get()
                u[sender] = value
            going = plant.step(u)
        done = plant.done()
        for agent in agents:
            await inbox.send_message((PLANT, STOP, 0.0, 0.0), agent)
    return done


def _run_agent(network: Network, me: int, ports: Sequence[int], here: Barrier) -> None:
    asyncio.run(_agent(network, me, ports, here))


def run(network: Network, steps: int) -> Done:
    """Run with the plant in this process."""
    n = len(network)
    fork = multiprocessing.get_context("fork")
    ports, here = _free_ports(n + 1), fork.Barrier(n + 1)
    for i in range(n):
        fork.Process(target=_run_agent, args=(network, i, ports, here), daemon=True).start()
    return asyncio.run(_plant(network, steps, ports, here))
