"""The world on the wire, and its clock: send state(t), wait for every input(t) and for nothing else, advance.

As in an agent, the work is done where messages arrive; the main thread keeps time. It releases a step that had
to wait (for its turn under `--rate`, or for an observer that fell behind), repeats a state that was not answered,
and gives up, by name, past the deadline.
"""

from __future__ import annotations

import argparse
import functools
import json
import logging
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import zenoh

from plant.truth import Truth
from plant.world import World
from topologies.errors import DeadlineError
from topologies.graph import Index
from wire import keys
from wire.child import run_child
from wire.codec import (
    ALL_UP,
    REPORT_WIDTH,
    End,
    Flags,
    Input,
    MessageError,
    Telemetry,
    decode_input,
    decode_seen,
    encode_end,
    encode_state,
    encode_telemetry,
    gather,
)
from wire.session import open_client, publisher, remove_socket, subscriber, wait_for_listeners

LOG = logging.getLogger("plant")
START_DEADLINE_S = 60.0
OBSERVER_DEADLINE_S = 60.0
RESEND_AFTER_S = 0.5
AHEAD_BYTES = 32 * 2**20
"""How much telemetry the plant may send before the observer has taken it in; it bounds the observer's memory."""


@dataclass
class _Shard:
    """One agent process as the plant sees it."""

    nodes: Index
    flags: bytes
    state: zenoh.Publisher
    message: bytes = b""
    alive: bool = False


@dataclass
class _Clock:
    """When the next state may leave."""

    period_s: float
    started: float = 0.0
    elapsed_s: float = 0.0
    sent_at: float = 0.0
    repeats: int = 0
    held: bool = False
    """state(t) is ready, and has not left yet"""

    def due(self, t: int) -> float:
        return self.started + t * self.period_s


class Plant:
    """The plant's process, from the first state to the end."""

    def __init__(self, truth: Truth, namespace: str, endpoint: str, rate: float, deadline_s: float) -> None:
        n, e = len(truth.ids), len(truth.edges)
        self.truth = truth
        self.world = World(truth)
        self._deadline_s = deadline_s
        self._edge_open: Flags = np.ones(e, dtype=np.uint8)
        self._link_up: Flags = np.ones(2 * e, dtype=np.uint8)
        self._clock = _Clock(1 / rate if rate else 0.0)
        self._ahead = max(2, min(4096, AHEAD_BYTES // (8 * n * (3 + REPORT_WIDTH) + 3 * e)))
        self._seen = -1
        self._inputs = [Input(-1, b"", b"") for _ in truth.shards]
        """Per shard: what it last said."""
        self._missing: set[int] = set()
        """Shards whose input(t) has not come."""
        self._order: Index = np.concatenate([np.array(nodes, dtype=np.int64) for nodes in truth.shards])
        """Nodes in the order of the shards, and `_place`, where each node stands in it."""
        self._place = self._order.argsort()
        self._running = False
        self._stopping = False
        self._failure: Exception | None = None
        self.refused = 0
        self._changed = threading.Condition()

        self._session = session = open_client(endpoint, namespace)
        self._telemetry = publisher(session, keys.TELEMETRY)
        degree = self.world.graph.degree
        self._shards = [
            _Shard(
                nodes=np.array(nodes, dtype=np.int64),
                flags=bytes([ALL_UP]) * int(degree[list(nodes)].sum()),
                state=publisher(session, keys.state(p)),
            )
            for p, nodes in enumerate(truth.shards)
        ]
        self._declared = [
            *(
                subscriber(session, keys.input_(p), functools.partial(self._take_input, p))
                for p in range(len(truth.shards))
            ),
            subscriber(session, keys.SEEN, self._take_seen),
            session.declare_queryable(keys.STATUS, zenoh.handlers.Callback(self._answer_status, indirect=False)),
            session.declare_queryable(keys.STOP, zenoh.handlers.Callback(self._answer_stop, indirect=False)),
            session.liveliness().declare_subscriber(
                keys.ALIVE, zenoh.handlers.Callback(self._take_alive, indirect=False), history=True
            ),
            session.liveliness().declare_token(keys.alive(keys.PLANT)),
        ]

    def run(self) -> None:
        """Keep time until the last step, a stop or a failure; raise DeadlineError past a deadline."""
        try:
            with self._changed:
                self._wait_for_agents()
            if not self._stopping:
                wait_for_listeners([self._telemetry, *(shard.state for shard in self._shards)])
            with self._changed:
                LOG.info("all %d agents are ready", len(self._shards))
                self._running = True
                self._clock.started = time.monotonic()
                self._prepare()
                while self._running:
                    self._changed.wait(self._keep_time())
        finally:
            self._end()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Leave the network."""
        self._session.close()  # type: ignore[no-untyped-call]

    # The clock: every method below runs with the lock of `_changed` held.

    def _wait_for_agents(self) -> None:
        def all_alive() -> bool:
            return self._stopping or all(shard.alive for shard in self._shards)

        if not self._changed.wait_for(all_alive, START_DEADLINE_S):
            late = [self._name(p) for p, shard in enumerate(self._shards) if not shard.alive]
            raise DeadlineError(f"{', '.join(late[:8])} not ready after {START_DEADLINE_S:g} s; see their logs")

    def _prepare(self) -> None:
        """Make state(t) ready, and let it go if it may; end when t is the last."""
        if self._stopping or self.world.t == self.truth.steps:
            self._running = False
            self._changed.notify_all()
            return
        self._missing.update(range(len(self._shards)))
        x, first = self.world.x.take(self._order).tobytes(), 0
        for shard in self._shards:
            last = first + 8 * len(shard.nodes)
            shard.message = encode_state(self.world.t, x[first:last], shard.flags)
            first = last
        self._clock.held = True
        self._release()

    def _release(self) -> None:
        if not self._clock.held or self._wait_s() > 0:
            return
        self._clock.held, self._clock.sent_at, self._clock.repeats = False, time.monotonic(), 0
        for shard in self._shards:
            shard.state.put(shard.message)

    def _wait_s(self) -> float:
        """How long state(t) must still be held: until its turn, or until the observer has caught up."""
        if self.world.t - self._seen > self._ahead:
            return RESEND_AFTER_S
        return self._clock.due(self.world.t) - time.monotonic() if self._clock.period_s else 0.0

    def _keep_time(self) -> float:
        """What the main thread has to do now; return in how many seconds to look again."""
        clock, now = self._clock, time.monotonic()
        if self._stopping:
            self._running = False
            return 0.0
        if clock.held:
            self._release()
            if clock.held and now - max(clock.sent_at, clock.due(self.world.t)) > OBSERVER_DEADLINE_S:
                raise DeadlineError(
                    f"step {self.world.t}: the observer has taken in nothing for {OBSERVER_DEADLINE_S:g} s"
                )
            return max(self._wait_s(), 0.0) if clock.held else RESEND_AFTER_S
        waited = now - clock.sent_at
        if waited > self._deadline_s:
            names = ", ".join(
                f"{self._name(p)} (alive: {'yes' if self._shards[p].alive else 'no'})" for p in sorted(self._missing)
            )
            raise DeadlineError(f"step {self.world.t}: no input from {names} for {waited:.1f} s; see its log")
        if waited > RESEND_AFTER_S * (clock.repeats + 1):
            clock.repeats += 1
            LOG.info(
                "step %d: repeated, still without shards %s",
                self.world.t,
                sorted(self._missing),
            )
            for shard in self._shards:
                shard.state.put(shard.message)
        return RESEND_AFTER_S

    def _advance(self) -> None:
        """Every input(t) is here: act, start t + 1, and only then tell the observer of t."""
        u = gather(one.u for one in self._inputs).take(self._place)
        if not math.isfinite(np.add.reduce(u)):
            self._refuse_undefined()
            return
        report = gather(one.report for one in self._inputs).reshape(-1, REPORT_WIDTH).take(self._place, axis=0)
        t, x = self.world.t, self.world.x
        w = self.world.step(u)
        self._clock.elapsed_s = time.monotonic() - self._clock.started
        self._prepare()
        self._telemetry.put(encode_telemetry(Telemetry(t, x, u, w, report, self._edge_open, self._link_up)))

    def _refuse_undefined(self) -> None:
        """Wait on for inputs that are numbers: no agent of ours sends any other."""
        for p, one in enumerate(self._inputs):
            if not np.isfinite(gather([one.u])).all():
                self._missing.add(p)
                self._refuse(p, "an input is not finite")

    def _end(self) -> None:
        end = End(self.world.t, self.world.x, self._clock.elapsed_s)
        self._telemetry.put(encode_end(end))
        for shard in self._shards:
            shard.state.put(encode_end(end._replace(x=np.empty(0))))
        LOG.info(
            "end at step %d of %d, %d messages refused",
            self.world.t,
            self.truth.steps,
            self.refused,
        )

    def _name(self, p: int) -> str:
        ids = [str(self.truth.ids[k]) for k in self._shards[p].nodes]
        return (
            f"agent {ids[0]}"
            if len(ids) == 1
            else f"shard {p} of agents {', '.join(ids[:4])}{', …' if len(ids) > 4 else ''}"
        )

    # What arrives: each method below takes the lock.

    def _take_input(self, p: int, message: bytes) -> None:
        with self._changed:
            if not self._running:
                return
            try:
                arrived = decode_input(message, len(self._shards[p].nodes))
            except MessageError as error:
                self._refuse(p, str(error))
                return
            if arrived.t == self.world.t and p in self._missing:
                self._inputs[p] = arrived
                self._missing.discard(p)
                if not self._missing:
                    self._advance_or_fail()

    def _refuse(self, p: int, why: str) -> None:
        self.refused += 1
        if self.refused == 1:
            LOG.warning("step %d: input of %s refused: %s", self.world.t, self._name(p), why)

    def _advance_or_fail(self) -> None:
        try:
            self._advance()
        except Exception as error:  # it must reach the main thread, not Zenoh's log
            self._failure, self._running = error, False
            self._changed.notify_all()

    def _take_seen(self, message: bytes) -> None:
        with self._changed:
            self._seen = max(self._seen, decode_seen(message))
            if self._running:
                self._release()

    def _take_alive(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).removeprefix("alive/")
        with self._changed:
            for p, shard in enumerate(self._shards):
                if keys.shard_name(p) == name:
                    shard.alive = sample.kind == zenoh.SampleKind.PUT
            self._changed.notify_all()

    def _answer_status(self, query: zenoh.Query) -> None:
        with self._changed:
            status = {
                "step": self.world.t,
                "steps": self.truth.steps,
                "running": self._running,
                "missing": [self._name(p) for p in sorted(self._missing)],
            }
        query.reply(keys.STATUS, json.dumps(status))

    def _answer_stop(self, query: zenoh.Query) -> None:
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
            t = self.world.t
        query.reply(keys.STOP, json.dumps({"step": t}))


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m plant TRUTH --namespace RUN --connect ENDPOINT`: run the world to its last step."""
    parser = argparse.ArgumentParser(prog="python -m plant", description=main.__doc__)
    parser.add_argument("truth", type=Path, help="the true network, a JSON file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    parser.add_argument("--connect", required=True, help="the router, a Zenoh endpoint")
    parser.add_argument("--rate", type=float, default=0.0, help="steps per second; 0 for as fast as possible")
    parser.add_argument("--deadline", type=float, default=10.0, help="seconds to wait for an input before giving up")
    parser.add_argument("--socket", type=Path, help="the parent's router's Unix socket, removed should the parent die")
    parser.add_argument("--listed", type=Path, help="the parent's entry among running networks, likewise")
    known = parser.parse_args(arguments)

    def body() -> None:
        plant = Plant(Truth.read(known.truth), known.namespace, known.connect, known.rate, known.deadline)
        try:
            plant.run()
        finally:
            plant.close()

    def clear_up() -> None:
        if known.listed:
            known.listed.unlink(missing_ok=True)
        if known.socket:
            remove_socket(known.socket)

    run_child(body, clear_up)
