"""The world on the wire, and its clock: send state(t), wait for every input(t) and for nothing else, advance.

As in an agent, the work is done where messages arrive; the main thread keeps time. It releases a step that had
to wait (for its turn, for a process that ends or begins, or for an observer that fell behind), repeats what was not
answered, and past the deadline goes on without who is silent, by name.
"""

from __future__ import annotations

import argparse
import functools
import logging
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import zenoh

from plant.clock import RESEND_AFTER_S, Clock
from plant.control import Control
from plant.truth import Truth
from plant.world import World
from topologies.effects import FOREVER, Effect
from topologies.errors import DeadlineError
from wire import keys
from wire.child import run_child
from wire.codec import (
    REPORT_WIDTH,
    End,
    Input,
    Kind,
    decode_event,
    decode_input,
    decode_seen,
    encode_end,
    encode_event,
    encode_record,
    encode_state,
    encode_telemetry,
    gather,
    kind_of,
)
from wire.session import (
    Ear,
    Voice,
    close,
    counts,
    open_client,
    open_router,
    publisher,
    remove_secrets,
    remove_socket,
    wait_for_listeners,
)
from wire.stream import Outbox

LOG = logging.getLogger("plant")
START_DEADLINE_S = 60.0
OBSERVER_DEADLINE_S = 60.0
END_DEADLINE_S = 5.0
WORD_DEADLINE_S = 2.0
"""How long a shard that is there has to say what it heard, once it is told of the end."""
AHEAD_BYTES = 32 * 2**20
"""How much telemetry the plant may send before the observer has taken it in; it bounds the memory of both."""


@dataclass
class _Shard:
    """One agent process as the plant sees it."""

    nodes: Sequence[int]
    incidences: int
    state: Voice
    messages: list[bytes] = field(default_factory=list)
    """what it is told at this step"""
    life: int = -1
    """how often it was started again; -1 before it was ever seen"""
    alive: bool = False
    """whether its token is there"""
    died: int = -1
    """the last life that is over"""
    gone: bool = False
    """that life was needed, and the step after its end has not begun"""
    fault: int | None = None
    """since it was lost: the number of the crash which that is, in the list of faults"""
    back: bool = False
    """it was heard of since then"""
    returning: bool = False
    """it was lost, and has not acted since it was taken back"""
    word: dict[str, Any] | None = None
    """its last: what it said and heard, by key"""
    external: bool = False
    """whoever runs it starts it again, and not we"""

    @property
    def ready(self) -> bool:
        """Whether it can be sent a state."""
        return self.alive and self.life > self.died


class Plant:
    """The plant's process, from the first state to the end."""

    def __init__(
        self,
        truth: Truth,
        session: zenoh.Session,
        rate: float,
        deadline_s: float,
        start_s: float = START_DEADLINE_S,
        network: str = "",
    ) -> None:
        """`start_s` is how long everybody has to come, `network` the fingerprint that who joins must have, too."""
        n, e = len(truth.ids), len(truth.edges)
        self.truth, self.network = truth, network
        self._start_s = start_s
        self.world = World(truth)
        self.clock = Clock(rate)
        self.fault_count = truth.faults
        self._deadline_s = deadline_s
        self._ahead = max(2, min(4096, AHEAD_BYTES // (8 * n * (3 + REPORT_WIDTH) + 5 * e)))
        self._missing: set[int] = set()
        """Shards whose input(t) has not come."""
        self._until: list[tuple[int, Callable[[], bool]]] = []
        """What state(t) is held for besides its turn: shards, and what must be true of them."""
        self._since = self._called_at = time.monotonic()
        """when state(t) was made ready, and when the lost were last called"""
        self._deserted = False
        """every shard that should be there is lost: t waits for one of them"""
        self.running = False
        self.over = False
        self.stopping = False
        self._failure: Exception | None = None
        self._elapsed_s = 0.0
        self._farewell = b""
        self.changed = threading.Condition()

        self._session = session
        self._telemetry = publisher(session, keys.TELEMETRY)
        self._outbox = Outbox(self._telemetry.put)
        degree = self.world.graph.degree
        self.shards = [
            _Shard(nodes.tolist(), int(degree[nodes].sum()), Voice(session, keys.state(p)))
            for p, nodes in enumerate(truth.shards)
        ]
        silence = (np.full(len(one.nodes) * (1 + REPORT_WIDTH), np.nan).tobytes() for one in self.shards)
        self._silence = [
            Input(-1, nan[: 8 * len(one.nodes)], nan[8 * len(one.nodes) :], bytes(one.incidences))
            for one, nan in zip(self.shards, silence, strict=True)
        ]
        self._inputs = list(self._silence)
        """Per shard: what it says at this step."""
        self._ears = [
            *(Ear(session, keys.input_(p), functools.partial(self._take_input, p)) for p in range(len(truth.shards))),
            Ear(session, keys.SEEN, self._take_seen),
        ]
        self._alive = session.liveliness().declare_subscriber(
            keys.ALIVE, zenoh.handlers.Callback(self._take_alive, indirect=False), history=True
        )
        self._control = Control(self, session)
        self._token = session.liveliness().declare_token(keys.alive(keys.PLANT))

    def run(self) -> None:
        """Keep time until the last step, a stop or a failure; raise DeadlineError past a deadline."""
        try:
            with self.changed:
                self._wait_for_agents()
            if not self.stopping:
                wait_for_listeners([self._telemetry, *(shard.state.publisher for shard in self.shards)], self._start_s)
            with self.changed:
                LOG.info("all %d agents are ready", len(self.shards))
                self.running = True
                self.clock.start()
                self._prepare()
                while self.running:
                    self.changed.wait(self._keep_time())
        finally:
            with self.changed:
                self.running = False  # whatever came between: nothing is told after the end
            self._end()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Leave the network."""
        close(self._session)

    # The clock: every method below runs with the lock of `changed` held.

    def _wait_for_agents(self) -> None:
        def all_alive() -> bool:
            return self.stopping or all(shard.alive for shard in self.shards)

        if not self.changed.wait_for(all_alive, self._start_s):
            late = [self.name(p) for p, shard in enumerate(self.shards) if not shard.alive]
            raise DeadlineError(f"{', '.join(late[:8])} not ready after {self._start_s:g} s; see their logs")

    def _prepare(self) -> None:
        """Make state(t) ready, and let it go if it may; end when t is the last."""
        world = self.world
        if self.stopping or world.t == self.truth.steps:
            self.running = False
            self.changed.notify_all()
            return
        for p, shard in enumerate(self.shards):
            if shard.fault is not None:
                self._take_back(p, shard, shard.fault)
            elif (shard.gone or shard.life <= shard.died) and world.wanted(p, world.t):
                self._lose(p, "its process died")
            shard.gone = False
        self._deserted = self._is_deserted()
        if self._deserted:
            self._since = time.monotonic()
            return
        world.begin()
        self._inputs = list(self._silence)
        self._until.clear()
        for p, (shard, (state, record)) in enumerate(zip(self.shards, world.states(), strict=True)):
            shard.messages = [] if record is None else [encode_record(record)]
            if state is not None:
                self._missing.add(p)
                shard.messages.append(encode_state(*state))
            elif shard.fault is None and not shard.external:
                self._await_crash(p, shard)
        self.clock.held, self._since = True, time.monotonic()
        self._release()

    def _is_deserted(self) -> bool:
        """Whether nobody would act at t, and not because the faults of the file say so."""
        lost = [shard for shard in self.shards if shard.fault is not None]
        there = (shard.fault is None and self.world.wanted(p, self.world.t) for p, shard in enumerate(self.shards))
        return bool(lost) and not any(there)

    def _await_crash(self, p: int, shard: _Shard) -> None:
        """Nobody of this shard is there at t: hold the step until its process is gone, or there again if it must."""
        t, life = self.world.t, shard.life
        if self.world.wanted(p, t - 1) and shard.died < life and not shard.returning:
            self.tell("kill", shard=p, life=life, restart=self.world.comes_back(p))
            self._until.append((p, lambda: shard.died >= life))
        if self.world.wanted(p, t + 1):
            if not shard.ready:
                self.tell("revive", shard=p)
            self._until.append((p, lambda: shard.ready))

    def _release(self) -> None:
        if self.clock.held and not self._held_for() and self._wait_s() <= 0:
            self.clock.sent()
            self._send_states()

    def _send_states(self) -> None:
        for shard in self.shards:
            for message in shard.messages:
                shard.state.put(message)

    def _held_for(self) -> list[int]:
        """Shards that state(t) is held for."""
        return [p for p, is_true in self._until if not is_true()]

    def _wait_s(self) -> float:
        """How long state(t) must still be held: until its turn, or until the observer has caught up."""
        return RESEND_AFTER_S if len(self._outbox) > self._ahead else self.clock.wait_s(self.world.t)

    def _keep_time(self) -> float:
        """What the main thread has to do now; return in how many seconds to look again."""
        if self.stopping:
            self.running = False
            return 0.0
        self._outbox.repeat_if_due()
        self._call_the_lost()
        if self._deserted:
            return self._look_for_anybody()
        if self.clock.held:
            self._release()
        if self.clock.held:
            self._check_hold()
            return min(max(self._wait_s(), 0.0), RESEND_AFTER_S)
        if self._missing and self.clock.waited_s() > self._deadline_s:
            self._go_on_without(sorted(self._missing))
        elif self._missing and self.clock.repeat_is_due():
            LOG.info("step %d: repeated, still without shards %s", self.world.t, sorted(self._missing))
            self._send_states()
        self._go_on()
        return min(RESEND_AFTER_S, max(0.01, self._deadline_s - self.clock.waited_s()))

    def _look_for_anybody(self) -> float:
        """Go on at t once one of the lost is back; DeadlineError past the deadline."""
        if any(shard.back for shard in self.shards):
            self._prepare()
            self._go_on()
        elif time.monotonic() - self._since > START_DEADLINE_S:
            names = ", ".join(self.name(p) for p in range(len(self.shards)))
            raise DeadlineError(f"step {self.world.t}: {names}: nobody is back after {START_DEADLINE_S:g} s")
        return RESEND_AFTER_S

    def _check_hold(self) -> None:
        """Whether state(t) is held for something that should have come long ago; DeadlineError if so."""
        t, now = self.world.t, time.monotonic()
        if len(self._outbox) > self._ahead and now - self._outbox.progress_at > OBSERVER_DEADLINE_S:
            raise DeadlineError(f"step {t}: the observer has taken in nothing for {OBSERVER_DEADLINE_S:g} s")
        if (held := self._held_for()) and now - self._since > START_DEADLINE_S:
            names = ", ".join(map(self.name, held))
            raise DeadlineError(f"step {t}: {names} neither gone nor back for {START_DEADLINE_S:g} s; see its log")

    def _go_on_without(self, late: Sequence[int]) -> None:
        waited = self.clock.waited_s()
        alive = [f"{self.name(p)} (alive: {'yes' if self.shards[p].alive else 'no'})" for p in late]
        if len(late) == sum(shard.fault is None and bool(shard.messages) for shard in self.shards):
            # Nobody at all answers: it is we who are cut off, or there is no network any more.
            raise DeadlineError(
                f"step {self.world.t}: no input from {', '.join(alive)} for {waited:.1f} s; see its log"
            )
        for p, who in zip(late, alive, strict=True):
            LOG.warning("step %d: no input from %s for %.1f s", self.world.t, who, waited)
            self._lose(p, f"no input from {who} for {waited:.1f} s")

    def _lose(self, p: int, why: str) -> None:
        """Go on without a shard: from t on it has crashed, as if a fault of the file had said so."""
        shard, t = self.shards[p], self.world.t
        shard.fault, shard.back = self.fault_count, False
        self.fault_count += 1
        self._missing.discard(p)
        shard.messages.clear()
        self.world.faults.add([Effect(shard.fault, "crash", tuple(shard.nodes), t, FOREVER)])
        self.tell("lost", shard=p, fault=shard.fault, who=self.name(p), cause=why)

    def _take_back(self, p: int, shard: _Shard, fault: int) -> None:
        """A lost shard that is there again hears its neighbours from t on, and acts from t + 1 on."""
        if shard.back and shard.life > shard.died:
            self.world.faults.end(fault, self.world.t + 1)
            self.tell("back", shard=p, fault=fault, who=self.name(p), at=self.world.t + 1)
            shard.fault, shard.returning = None, True

    def _call_the_lost(self) -> None:
        """Who was lost by the deadline may be there again: it answers a state of a step that never comes."""
        if time.monotonic() - self._called_at < RESEND_AFTER_S:
            return
        self._called_at = time.monotonic()
        for shard in self.shards:
            if shard.fault is not None and shard.died < shard.life:
                nothing = np.full(len(shard.nodes), np.nan)
                shard.state.put(encode_state(FOREVER, nothing, bytes(shard.incidences)))

    def _go_on(self) -> None:
        """Make all steps that can be made; a failure must reach the main thread, not Zenoh's log."""
        try:
            while self.running and not (self.clock.held or self._missing or self._deserted):
                self._advance()
        except Exception as error:
            self._failure, self.running = error, False
            self.changed.notify_all()

    def _advance(self) -> None:
        """Every input(t) is here: act, start t + 1, and only then tell the observer of t."""
        inputs = self._inputs
        u, report = gather([one.u for one in inputs]), gather([one.report for one in inputs])
        row = self.world.step(u, report.reshape(-1, REPORT_WIDTH), b"".join([one.took for one in inputs]))
        self._elapsed_s = time.monotonic() - self.clock.began
        self._prepare()
        self._outbox.send(encode_telemetry(row))

    def tell(self, event: str, **details: Any) -> None:
        """Tell the observer of something that happens at this step."""
        self._outbox.send(encode_event(self.world.t, {"event": event, **details}))

    def _end(self) -> None:
        """Say that it is over, and wait until the observer knows all of it, and who heard what."""
        end = End(self.world.t, self.world.x, self._elapsed_s, self.world.links.forgotten)
        with self.changed:
            self.over = True
            self._farewell = encode_end(end._replace(x=np.empty(0)))
            for shard in self.shards:
                shard.state.put(self._farewell)
            self.changed.wait_for(lambda: all(shard.word or not shard.ready for shard in self.shards), WORD_DEADLINE_S)
            self.tell(
                "heard",
                plant=counts([shard.state for shard in self.shards], self._ears[: len(self.shards)]),
                shards=[shard.word for shard in self.shards],
            )
            self._outbox.send(encode_end(end))
            by = time.monotonic() + END_DEADLINE_S
            while self._outbox and (left := by - time.monotonic()) > 0:
                self._outbox.repeat_if_due()
                self.changed.wait(min(left, RESEND_AFTER_S))
        refused = sum(ear.refused for ear in self._ears)
        LOG.info("end at step %d of %d, %d messages refused", self.world.t, self.truth.steps, refused)

    def name(self, p: int) -> str:
        """What messages call a shard."""
        ids = [str(self.truth.ids[k]) for k in self.shards[p].nodes]
        if len(ids) == 1:
            return f"agent {ids[0]}"
        return f"shard {p} of agents {', '.join(ids[:4])}{', …' if len(ids) > 4 else ''}"

    @property
    def missing(self) -> list[str]:
        """Whose input(t) has not come for a while."""
        late = not self.clock.held and self.clock.waited_s() > RESEND_AFTER_S
        return [self.name(p) for p in sorted(self._missing)] if late else []

    # What arrives: each method below takes the lock.

    def _take_input(self, p: int, message: bytes) -> None:
        with self.changed:
            shard = self.shards[p]
            if self.over and kind_of(message) == Kind.EVENT:
                shard.word = shard.word or decode_event(message)
                shard.state.put(self._farewell)
                self.changed.notify_all()
                return
            arrived = decode_input(message, len(shard.nodes), shard.incidences)
            if shard.fault is not None:
                shard.back = True
                self.changed.notify_all()
            elif arrived.t == self.world.t and p in self._missing and self.running:
                self._inputs[p], shard.returning = arrived, False
                self._missing.discard(p)
                if not self._missing:
                    self._go_on()

    def _take_seen(self, message: bytes) -> None:
        with self.changed:
            self._outbox.seen(decode_seen(message))
            if self.running and self.clock.held:
                self._release()
                self._go_on()
            elif not self.running:
                self.changed.notify_all()

    def _take_alive(self, sample: zenoh.Sample) -> None:
        said = re.fullmatch(r"alive/shard-([0-9]{1,9})/([0-9]{1,9})", str(sample.key_expr))
        if said is None or int(said[1]) >= len(self.shards):
            return
        shard, life = self.shards[int(said[1])], int(said[2])
        with self.changed:
            if life >= shard.life:
                if life > max(0, shard.life):
                    self.died(int(said[1]), life - 1)  # nobody else may have seen the end of a process far away
                shard.alive = sample.kind == zenoh.SampleKind.PUT
                shard.back = shard.back or life > shard.life
                shard.life = life
            self.changed.notify_all()

    def died(self, p: int, life: int) -> None:
        """The process of a shard is gone, says who started it."""
        shard = self.shards[p]
        if life <= shard.died:
            return
        shard.died, shard.life = life, max(shard.life, life)
        if shard.fault is None and self.running:
            if p in self._missing:
                self._lose(p, "its process died")
                self._go_on()
            else:
                shard.gone = self.world.wanted(p, self.world.t)
        self.changed.notify_all()


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m plant TRUTH --namespace RUN --listen ENDPOINT`: run the world to its last step."""
    parser = argparse.ArgumentParser(prog="python -m plant", description=main.__doc__)
    parser.add_argument("truth", type=Path, help="the true network, a .npz file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", help="be the router of the run, on a Zenoh endpoint")
    where.add_argument("--connect", help="the router, a Zenoh endpoint")
    parser.add_argument("--rate", type=float, default=0.0, help="steps per second; 0 for as fast as possible")
    parser.add_argument("--deadline", type=float, default=10.0, help="seconds to wait for an input before going on")
    parser.add_argument("--start", type=float, default=START_DEADLINE_S, help="seconds that everybody has to come")
    parser.add_argument("--network", default="", help="its fingerprint, which who joins must have, too")
    parser.add_argument("--socket", type=Path, help="the Unix socket listened on, removed should the parent die")
    parser.add_argument("--listed", type=Path, help="the parent's entry among running networks, likewise")
    parser.add_argument("--credentials", type=Path, help="the folder with its certificate")
    parser.add_argument("--secrets", type=Path, help="the folder with everybody's, likewise removed")
    known = parser.parse_args(arguments)

    def body() -> None:
        # First of all: the others wait for it.
        if known.listen:
            session = open_router(known.listen, known.namespace, known.credentials)
        else:
            session = open_client(known.connect, known.namespace, known.credentials)
        plant = Plant(Truth.read(known.truth), session, known.rate, known.deadline, known.start, known.network)
        try:
            plant.run()
        finally:
            plant.close()

    def clear_up() -> None:
        if known.secrets:
            remove_secrets(known.secrets)
        if known.listed:
            known.listed.unlink(missing_ok=True)
        if known.socket:
            remove_socket(known.socket)

    run_child(body, clear_up)
