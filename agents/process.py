"""A shard on the wire: state and links in, input and links out.

The work is done where messages arrive, on the network thread; the main thread only watches the clock, so
that a step costs no change of threads. A step begins with the state message of t and needs the link messages of
t - 1 from every peer whose link was up; whichever comes last sets it off.
"""

from __future__ import annotations

import argparse
import functools
import logging
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import zenoh

from agents.shard import Shard
from agents.view import View
from wire import keys
from wire.child import run_child
from wire.codec import (
    Array,
    Flag,
    Kind,
    MessageError,
    State,
    decode_link,
    decode_state,
    encode_input,
    encode_link,
    gather,
    kind_of,
)
from wire.session import open_client, publisher, subscriber, wait_for_listeners

LOG = logging.getLogger("agent")
_SILENCE = struct.pack("<d", math.nan)
PATIENCE_S = 1.0
"""How long a step may take before the log says what it waits for."""


class Agent:
    """One shard's process, from the first state message to the end."""

    def __init__(self, view: View, namespace: str, endpoint: str) -> None:
        self.shard = Shard(view)
        self.peers = [peer.shard for peer in view.peers]
        self._hears = [len(peer.hear) for peer in view.peers]
        self.t = -1
        """The last step answered."""
        self._pending: State | None = None
        self._since = time.monotonic()
        self._heard: list[dict[int, bytes]] = [{} for _ in self.peers]
        """Per peer: inputs by step, of the steps that no sample has used yet."""
        self._u = b""
        """Our own inputs of the last step."""
        self._said: deque[list[tuple[zenoh.Publisher, bytes]]] = deque(maxlen=2)
        """What went out in the last two steps: a neighbour may still need the one before the last."""
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._failure: Exception | None = None
        self.refused = 0

        self._session = open_client(endpoint, namespace)
        name = keys.shard_name(view.shard)
        self._subscribers = [
            self._hear(keys.link(peer, view.shard), functools.partial(self._take_link, p))
            for p, peer in enumerate(self.peers)
        ]
        self._subscribers.append(self._hear(keys.state(view.shard), self._take_state))
        self._input = publisher(self._session, keys.input_(view.shard))
        self._links = [publisher(self._session, keys.link(view.shard, peer)) for peer in self.peers]
        wait_for_listeners([self._input, *self._links])
        self._token = self._session.liveliness().declare_token(keys.alive(name))

    def run(self) -> None:
        """Wait for the end, saying in the log what a slow step waits for; raises what a message provoked."""
        said = -1
        while not self._ended.wait(PATIENCE_S):
            with self._lock:
                late = self._pending is not None and time.monotonic() - self._since > PATIENCE_S
                if late and self._pending is not None and self._pending.t != said:
                    said = self._pending.t
                    missing = [self.peers[p] for p in self._missing(self._pending)]
                    LOG.warning(
                        "step %d: no link message of step %d from shards %s",
                        said,
                        said - 1,
                        missing,
                    )
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Leave the network."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _hear(self, key: str, take: Callable[[bytes], None]) -> zenoh.Subscriber[None]:
        """Take what comes on `key`, one message at a time; what is no message is refused, and the law may raise."""

        def on_message(message: bytes) -> None:
            with self._lock:
                try:
                    take(message)
                except MessageError as error:
                    self.refused += 1
                    if self.refused == 1:
                        LOG.warning("%s: refused: %s", key, error)
                except Exception as error:  # it must reach the main thread, not Zenoh's log
                    self._failure = error
                    self._ended.set()

        return subscriber(self._session, key, on_message)

    def _take_state(self, message: bytes) -> None:
        if kind_of(message) == Kind.END:
            self._ended.set()
            return
        state = decode_state(message, self.shard.k, self.shard.m)
        if state.t not in (self.t, self.t + 1):
            return
        if state.t == self.t or self._pending is not None:
            # The plant repeats itself: somebody missed something, so everybody says again what they said.
            for neighbour, payload in (each for step in self._said for each in step):
                neighbour.put(payload)
        if state.t == self.t + 1:
            self._pending, self._since = state, time.monotonic()
            self._step_if_complete()

    def _take_link(self, peer: int, message: bytes) -> None:
        link = decode_link(message, self._hears[peer])
        if link.t >= self.t:
            self._heard[peer][link.t] = link.u
            if self._pending is not None:
                self._step_if_complete()

    def _missing(self, state: State) -> list[int]:
        if state.t == 0:
            return []
        return [p for p in self.shard.peers_with(Flag.HEAR, state.flags) if state.t - 1 not in self._heard[p]]

    def _step_if_complete(self) -> None:
        state = self._pending
        if state is None or self._missing(state):
            return
        self._pending = None
        shard = self.shard
        u = shard.step(state.x, state.flags, self._inputs_of(state.t - 1)) if state.t else shard.start(state.x)
        self.t, self._u = state.t, u.tobytes()
        out = [(self._links[p], self._link_to(p, state.x, u)) for p in shard.peers_with(Flag.TELL, state.flags)]
        out.append((self._input, encode_input(state.t, self._u, shard.report)))
        self._said.append(out)
        for neighbour, payload in out:
            neighbour.put(payload)

    def _inputs_of(self, t: int) -> Array:
        """The inputs of step t: our own, then those of all peers, in their order; NaN where none came."""
        heard = (said.pop(t, _SILENCE * n) for said, n in zip(self._heard, self._hears, strict=True))
        return gather((self._u, *heard))

    def _link_to(self, peer: int, x: Array, u: Array) -> bytes:
        nodes = self.shard.say[peer]
        if nodes is None:
            return encode_link(self.t, x, self._u)
        return encode_link(self.t, x[nodes], u[nodes])


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m agents VIEW --namespace RUN --connect ENDPOINT`: run one shard until the plant says END."""
    parser = argparse.ArgumentParser(prog="python -m agents", description=main.__doc__)
    parser.add_argument("view", type=Path, help="the local view, a JSON file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    parser.add_argument("--connect", required=True, help="the router, a Zenoh endpoint")
    known = parser.parse_args(arguments)

    def body() -> None:
        view = View.read(known.view)
        agent = Agent(view, known.namespace, known.connect)
        LOG.info("ready: shard %d of nodes %s", view.shard, [node.id for node in view.nodes][:20])
        try:
            agent.run()
        finally:
            agent.close()
        LOG.info("end: %d steps answered, %d messages refused", agent.t + 1, agent.refused)

    run_child(body)
