"""A shard on the wire: state and links in, input and links out.

The work is done where messages arrive, on the network thread; the main thread only watches the clock, so
that a step costs no change of threads. A step begins with the state message of t and needs the link messages of
t - 1 from every peer whose link was up; whichever comes last sets it off.

To say something long takes until it is read. So where messages are long, the network thread only takes them in, and the
main thread does the work: or two processes that say something long would wait to be heard, and neither would hear.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import zenoh

from agents.shard import Shard
from agents.view import View
from wire import keys
from wire.child import run_child
from wire.codec import (
    REPORT_WIDTH,
    Kind,
    MessageError,
    State,
    decode_end,
    decode_link,
    decode_record,
    decode_state,
    encode_event,
    encode_input,
    encode_link,
    kind_of,
)
from wire.session import (
    CONNECT_TIMEOUT_S,
    LISTEN_TIMEOUT_S,
    Ear,
    Mail,
    Voice,
    close,
    counts,
    open_client,
    wait_for_listeners,
)

LOG = logging.getLogger("agent")
NO_STEP = 2**62
"""The step of an input that is none."""
PATIENCE_S = 1.0
"""How long a step may take before the log says what it waits for."""
LONG_BYTES = 2**14
"""A message that Zenoh may not take at once: what waits to be sent has room for a few of 64 kB."""


@dataclass(frozen=True)
class Begin:
    """How a shard begins."""

    life: Callable[[zenoh.Session], int]
    """how often it was started before"""
    wait_s: float | None = None
    """how long it waits for the router and for the others, if not as long as among processes that `up` starts"""


class Agent:
    """One shard's process, from the first state message to the end."""

    def __init__(
        self, view: View, namespace: str, endpoint: str, begin: Begin, credentials: Path | None = None
    ) -> None:
        self.shard = Shard(view)
        self.peers = [peer.shard for peer in view.peers]
        self._pending: State | None = None
        self._since = time.monotonic()
        self._said: deque[list[tuple[Voice, bytes]]] = deque(maxlen=2)
        """What went out in the last two steps: a neighbour may still need the one before the last."""
        self._lock = threading.Lock()
        self._mail: Mail | None = None
        """what the main thread is to take, where messages are long"""
        if 8 * (1 + REPORT_WIDTH) * self.shard.k + self.shard.m > LONG_BYTES:
            self._mail = Mail()
        self._ended = threading.Event()
        self._failure: Exception | None = None
        self._over = False
        """the plant has said END, and we our last word"""

        self._session = open_client(endpoint, namespace, credentials, begin.wait_s or CONNECT_TIMEOUT_S)
        self._input = Voice(self._session, keys.input_(view.shard))
        self._links = [Voice(self._session, keys.link(view.shard, peer)) for peer in self.peers]
        self._ears = [
            self._hear(keys.link(peer, view.shard), functools.partial(self._take_link, p))
            for p, peer in enumerate(self.peers)
        ]
        self._ears.append(self._hear(keys.state(view.shard), self._take_state))
        self._life = life = begin.life(self._session)
        # Of a neighbour that is dead itself nobody listens: who comes back waits for the plant alone.
        voices = [self._input] if life else [self._input, *self._links]
        wait_for_listeners([voice.publisher for voice in voices], begin.wait_s or LISTEN_TIMEOUT_S)
        self._token = self._session.liveliness().declare_token(keys.alive(keys.shard_name(view.shard), life))

    def run(self) -> None:
        """Wait for the end, saying in the log what a slow step waits for; raises what a message provoked."""
        said = -1
        while not self._wait(PATIENCE_S):
            if self._over:
                break
            with self._lock:
                late = self._pending is not None and time.monotonic() - self._since > PATIENCE_S
                if late and self._pending is not None and self._pending.t != said:
                    said = self._pending.t
                    missing = [self.peers[p] for p in self.shard.awaits(self._pending)]
                    LOG.warning("step %d: no link message of step %d from shards %s", said, said - 1, missing)
        if self._failure is not None:
            raise self._failure

    def _wait(self, timeout_s: float) -> bool:
        """Whether the end comes within so long; messages that are the main thread's to take are taken meanwhile."""
        if self._mail is None:
            return self._ended.wait(timeout_s)
        by = time.monotonic() + timeout_s
        while not self._ended.is_set() and (left := by - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                self._mail.get(timeout=left)()
        return self._ended.is_set()

    def close(self) -> None:
        """Leave the network."""
        close(self._session)

    @property
    def refused(self) -> int:
        """How many messages were none."""
        return sum(ear.refused for ear in self._ears)

    def _hear(self, key: str, take: Callable[[bytes], None]) -> Ear:
        """Take what comes on `key`, one message at a time; what is no message is refused, and the law may raise."""

        def on_message(message: bytes) -> None:
            with self._lock:
                if self._ended.is_set():
                    return
                try:
                    take(message)
                except MessageError:
                    raise
                except Exception as error:  # it must reach the main thread, not Zenoh's log
                    self._failure = error
                    self._ended.set()

        return Ear(self._session, key, on_message, self._mail)

    def _take_state(self, message: bytes) -> None:
        kind = kind_of(message)
        if kind == Kind.END:
            decode_end(message, 0)
            if self._over:
                self._ended.set()
                return
            self._over = True
            counted = counts([self._input, *self._links], self._ears)
            counted["said"][self._input.key] += 1  # this last word too
            # To leave at once would lose it: the plant says END again when it has it.
            self._input.put(encode_event(max(0, self.shard.t), {"event": "counted", "life": self._life, **counted}))
        elif kind == Kind.RECORD:
            self.shard.recall(decode_record(message, self.shard.degrees))
        else:
            self._take(decode_state(message, self.shard.k, self.shard.m))

    def _take(self, state: State) -> None:
        done = self.shard.t
        if state.t == done or (self._pending is not None and self._pending.t == state.t):
            # The plant repeats itself: somebody missed something, so everybody says again what they said.
            for neighbour, payload in (each for step in self._said for each in step):
                neighbour.put(payload)
        elif self.shard.follows(state):
            self._pending, self._since = state, time.monotonic()
            self._step_if_complete()
        elif state.t > done:
            # The network went on without us: say that we are here, and the plant tells us all that we missed.
            self._input.put(encode_input(NO_STEP, *self.shard.silence))

    def _take_link(self, peer: int, message: bytes) -> None:
        self.shard.hear(peer, decode_link(message, self.shard.hears[peer]))
        if self._pending is not None:
            self._step_if_complete()

    def _step_if_complete(self) -> None:
        state, shard = self._pending, self.shard
        if state is None or shard.awaits(state):
            return
        self._pending = None
        u = shard.answer(state)
        out = [(self._links[p], encode_link(link, shard.says[p])) for p, link in shard.say(state)]
        out.append((self._input, encode_input(state.t, u, shard.report, shard.took)))
        self._said.append(out)
        for neighbour, payload in out:
            neighbour.put(payload)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m agents VIEW --namespace RUN --connect ENDPOINT`: run one shard until the plant says END."""
    parser = argparse.ArgumentParser(prog="python -m agents", description=main.__doc__)
    parser.add_argument("view", type=Path, help="the local view, a .npz file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    parser.add_argument("--connect", required=True, help="the router, a Zenoh endpoint")
    parser.add_argument("--life", type=int, default=0, help="how often this shard was started before")
    parser.add_argument("--credentials", type=Path, help="the folder with its certificate")
    known = parser.parse_args(arguments)

    def body() -> None:
        view = View.read(known.view)
        agent = Agent(view, known.namespace, known.connect, Begin(lambda _: known.life), known.credentials)
        LOG.info("ready: shard %d of nodes %s", view.shard, view.ids[:20].tolist())
        try:
            agent.run()
        finally:
            agent.close()
        LOG.info("end: %d steps answered, %d messages refused", agent.shard.t + 1, agent.refused)

    run_child(body)
