"""A shard connected to Zenoh: it receives state and link messages and sends input and link messages.

The work is done where messages arrive, on the network thread; the main thread only watches the clock, so that a step
costs no change of threads. A step begins with the state message of t. It needs the link messages of t - 1 from every
peer with a link that was up. The last of these messages starts the step.

A large send blocks until it is read, so large messages are sent on the main thread. Otherwise two processes that
send each other large messages would both block, and neither would read.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import logging
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import zenoh

from hedgerow.agents.law_source import need_source
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.topologies.paths import user_path
from hedgerow.wire import keys
from hedgerow.wire.access import MOST_PER_S
from hedgerow.wire.child import SLOW_LAW, run_child
from hedgerow.wire.codec import (
    decode_end,
    decode_record,
    decode_state,
    encode_event,
    encode_input,
    kind_of,
)
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.message import Kind, MessageError, State
from hedgerow.wire.runtime import LONG_BYTES, keep_memory, one_network_thread
from hedgerow.wire.session import (
    CONNECT_TIMEOUT_S,
    LISTEN_TIMEOUT_S,
    Receiver,
    Sender,
    close,
    counts,
    open_client,
    wait_for_listeners,
)
from hedgerow.wire.shared_steps import PLANT, open_steps, worth_sharing

LOG = logging.getLogger("agent")
NO_STEP = 2**62
"""step number of an input message without an input"""
PAUSE_S = 20 / MOST_PER_S
"""pause before the last message; a secure router drops a message that follows another too closely"""
PATIENCE_S = 1.0
"""time that a step may take before the log names the missing messages"""

SLOW_EVERY_S = 5.0
"""time between two lines about a slow law"""


class _Answering(NamedTuple):
    """The step that a thread answers now, since when by time.monotonic()."""

    t: int
    thread: int
    since: float


class Joined(NamedTuple):
    """A shard's place in a run."""

    life: int
    """the number of earlier lives; -1 if the place is not ours"""
    plant: int = -1
    """the number of the plant that gave it; -1 if no plant was asked"""


@dataclass(frozen=True)
class Begin:
    """The start of a shard."""

    join: Callable[[zenoh.Session], Joined]
    """takes the place; a second call takes the same place"""
    wait_s: float | None = None
    """the time to wait for the router and the other processes [s]; None for the default of `up`"""


class Agent:
    """One shard's process, from the first state message to the end."""

    def __init__(
        self,
        view: View,
        namespace: str,
        endpoint: str,
        begin: Begin,
        credentials: Credentials | Path | None = None,
        memory: tuple[str, int] | None = None,
    ) -> None:
        """Take a place in the run; `memory` is the path of memory that the plant shares, and the life of the shard."""
        need_source(view.law, view.law_source)
        self._view, self.shard = view, Shard(view)
        self.peers = [peer.shard for peer in view.peers]
        self._pending: State | None = None
        self._since = time.monotonic()
        self._sent: deque[list[tuple[Sender, bytes]]] = deque(maxlen=2)
        """The messages sent in the last two steps; a neighbour may still need those of the step before the last."""
        self._answering: _Answering | None = None
        self._slow_reported = 0.0
        """when the log last named a slow law, by time.monotonic()"""
        self._repeated = 0
        """number of repetitions of these messages"""
        self._lock = threading.Lock()
        self._later: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        """sends queued for the main thread"""
        self._unsent = 0
        """number of queued sends not done yet"""
        k, m = self.shard.k, self.shard.m
        self._memory = None if memory is None else open_steps(memory[0], k, m, memory[1] + 1)
        """memory for states and inputs; None if they travel in messages"""
        if worth_sharing(k, m):
            keep_memory()
        if self._memory is not None or not worth_sharing(k, m):
            one_network_thread()
        self._ended = threading.Event()
        self._failure: Exception | None = None
        self._over = False
        """True once the plant sent END and we answered it"""

        self.joined = Joined(-1)
        self._closed = True
        """True while messages are ignored: until we have the place, because another process may have it, and at the end
        """

        self.session = open_client(endpoint, namespace, credentials, begin.wait_s or CONNECT_TIMEOUT_S)
        try:
            self._join(begin)
        except BaseException:
            close(self.session)
            raise

    def _join(self, begin: Begin) -> None:
        view = self._view
        self._input = Sender(self.session, keys.input_(view.shard))
        self._links = [Sender(self.session, keys.link(view.shard, peer)) for peer in self.peers]
        self._quiet_senders = [[self._links[p] for p in peers] for _, peers in self.shard.audience] + [[self._input]]
        """By message of a quiet step: its senders."""
        self._receivers = [
            Receiver(self.session, keys.link(peer, view.shard), functools.partial(self._take_link, p))
            for p, peer in enumerate(self.peers)
        ]
        self._receivers.append(Receiver(self.session, keys.state(view.shard), self._take_state))
        # A dead neighbour has no subscriber, so a shard that comes back waits only for the plant.
        senders = [self._input] if begin.join(self.session).life else [self._input, *self._links]
        LOG.info("shard %d has its place, and waits for the others", view.shard)
        wait_for_listeners([sender.publisher for sender in senders], begin.wait_s or LISTEN_TIMEOUT_S)
        # Waiting may take minutes. Ask again: another process may have our place, or another run may have begun.
        self.joined = begin.join(self.session)
        with self._lock:
            self._closed = self._ended.is_set()

    def live(self) -> None:
        """Take part until the end, then leave the network, and log both. Raises the same errors as `run`."""
        if not self._ended.is_set():
            alive = keys.alive(keys.shard_name(self._view.shard), *self.joined)
            self._token = self.session.liveliness().declare_token(alive)
            LOG.info("ready: shard %d of nodes %s", self._view.shard, self._view.ids[:20].tolist())
        try:
            self.run()
        finally:
            self.close()
        LOG.info("end: %d steps answered, %d messages refused", self.shard.t + 1, self.refused)

    def run(self) -> None:
        """Wait for the end and log the missing messages of a slow step; raise the error that a message caused."""
        warned = -1
        while not self._wait(PATIENCE_S):
            if self._over:
                break
            if self._report_slow_law():  # the law runs under the lock
                continue
            with self._lock:
                late = self._pending is not None and time.monotonic() - self._since > PATIENCE_S
                if late and self._pending is not None and self._pending.t != warned:
                    warned = self._pending.t
                    missing = [self.peers[p] for p in self.shard.awaits(self._pending)]
                    LOG.warning("step %d: no link message of step %d from shards %s", warned, warned - 1, missing)
        if self._failure is not None:
            raise self._failure

    def _report_slow_law(self) -> bool:
        """Log the line that a law executes if it takes long; return True if the law runs now."""
        answering, now = self._answering, time.monotonic()
        if answering is None:
            return False
        if now - answering.since > PATIENCE_S and now - self._slow_reported > SLOW_EVERY_S:
            self._slow_reported = now
            where = self.shard.running(answering.thread)
            LOG.warning(
                "step %d: law %s %s %.1f s%s", answering.t, self._view.law, SLOW_LAW, now - answering.since, where
            )
        return True

    def _wait(self, timeout_s: float) -> bool:
        """Return True if the end comes within the timeout; meanwhile do the sends of the main thread."""
        by = time.monotonic() + timeout_s
        while not self._ended.is_set() and (left := by - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                self._later.get(timeout=left)()
                with self._lock:
                    self._unsent -= 1
        return self._ended.is_set()

    def _send_later(self, send: Callable[[], None]) -> None:
        """Queue a send for the main thread; the lock is held, as in every message handler."""
        self._unsent += 1
        self._later.put(send)

    def give_up(self, error: Exception) -> None:
        """Make `run` raise this error, unless the plant already sent END."""
        with self._lock:
            if not self._over:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._failure = error
        self._end()

    def _end(self) -> None:
        self._closed = True
        self._ended.set()
        self._send_later(lambda: None)

    def close(self) -> None:
        """Leave the network."""
        close(self.session)

    @property
    def refused(self) -> int:
        """Return the number of refused messages."""
        return sum(receiver.refused for receiver in self._receivers)

    # Messages. A malformed one is refused; any other error must reach the main thread, and not Zenoh's log.

    def _take_state(self, message: bytes) -> None:
        with self._lock:
            if self._closed:
                return
            try:
                if self._answers_quietly(message):
                    return
                kind = kind_of(message)
                if kind == Kind.PLACE and self._memory is not None:
                    message = self._memory.copy(message)
                    kind = kind_of(message)
                if kind == Kind.END:
                    decode_end(message, 0)
                    if self._over:
                        self._end()
                    else:
                        self._send_later(self._send_last)
                elif kind == Kind.RECORD:
                    self.shard.recall(decode_record(message, self.shard.degrees))
                else:
                    self._take(decode_state(message, self.shard.k, self.shard.m))
            except MessageError:
                raise
            except Exception as error:
                self._fail(error)

    def _answers_quietly(self, message: bytes) -> bool:
        """Answer a state and return True; False, with nothing changed, if its step is not quiet."""
        if (answer := self.shard.answer_quietly(message)) is None:
            return False
        out = []
        for senders, sent in zip(self._quiet_senders, answer, strict=False):
            for sender in senders:
                out.append((sender, sent))
        self._sent.append(out)
        if self._unsent:
            self._send_later(functools.partial(_put_all, out))
        else:
            for sender, sent in out:
                sender.put(sent)
        return True

    def _take_link(self, peer: int, message: bytes) -> None:
        with self._lock:
            if self._closed:
                return
            try:
                self.shard.receive_message(peer, message)
                if self._pending is not None:
                    self._step_if_complete()
            except MessageError:
                raise
            except Exception as error:
                self._fail(error)

    def _send_last(self) -> None:
        if self._over:  # END arrived twice; a second report would differ from the first, and the audit would count both
            return
        counted = counts([self._input, *self._links], self._receivers)
        counted["sent"][self._input.key] += 1  # count this event too
        # Leaving at once would lose the event. The plant sends END again after it received the event.
        report = encode_event(max(0, self.shard.t), {"event": "counted", "life": self.joined.life, **counted})
        self._ended.wait(PAUSE_S)
        self._over = True  # set it last, because a process that is over may leave
        self._input.put(report)

    def _take(self, state: State) -> None:
        done = self.shard.t
        if state.t == done or (self._pending is not None and self._pending.t == state.t):
            # The plant repeats its state because a message was missed, so every shard repeats its messages.
            # Repeat one step each time, the newer first: a secure router drops messages that follow too closely.
            if self._sent and not self._unsent:
                which = -1 - self._repeated % len(self._sent)
                self._repeated += 1
                self._send_later(functools.partial(_put_all, self._sent[which]))
        elif self.shard.follows(state):
            self._pending, self._since = state, time.monotonic()
            self._step_if_complete()
        elif state.t > done and not self._unsent:
            # The network advanced without us. Announce ourselves, and the plant sends everything that we missed.
            here = [(self._input, encode_input(NO_STEP, *self.shard.silence))]
            self._send_later(functools.partial(_put_all, here))

    def _step_if_complete(self) -> None:
        state, shard = self._pending, self.shard
        if state is None or shard.awaits(state):
            return
        self._pending = None
        self._answering = _Answering(state.t, threading.get_ident(), time.monotonic())
        shard.step(state)
        self._answering = None
        links, own = shard.messages(state)
        out = [(self._links[p], message) for peers, message in links for p in peers]
        if self._memory is not None and self._memory.has(PLANT):
            own = self._memory.write(state.t, own)
        out.append((self._input, own))
        self._sent.append(out)
        if self._unsent or sum(len(message) for _, message in out) > LONG_BYTES:
            self._send_later(functools.partial(_put_all, out))
        else:
            _put_all(out)


def _put_all(messages: Sequence[tuple[Sender, bytes]]) -> None:
    for sender, message in messages:
        sender.put(message)


def options() -> argparse.ArgumentParser:
    """Return the parser of the arguments; the program that forks agents parses them, because that takes memory."""
    parser = argparse.ArgumentParser(prog="python -m hedgerow.agents", description=main.__doc__)
    parser.add_argument("view", type=user_path, help="the local view, a .npz file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    parser.add_argument("--connect", required=True, help="the router, a Zenoh endpoint")
    parser.add_argument("--life", type=int, default=0, help="how often this shard was started before")
    parser.add_argument("--credentials", type=user_path, help="the folder with its certificate")
    parser.add_argument("--memory", help="memory that it shares with the plant")
    parser.add_argument("--law-path", type=user_path, help="a folder to import the law from, before all others")
    return parser


def run(known: argparse.Namespace) -> NoReturn:
    """Run one shard with these arguments."""

    def body() -> None:
        if known.law_path is not None:
            sys.path.insert(0, str(known.law_path))
        view = View.read(known.view)
        memory = (known.memory, known.life) if known.memory else None
        begin = Begin(lambda _: Joined(known.life))
        Agent(view, known.namespace, known.connect, begin, known.credentials, memory).live()

    run_child(body)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m hedgerow.agents VIEW --namespace RUN --connect ENDPOINT`: run one shard until the plant sends END."""
    run(options().parse_args(arguments))
