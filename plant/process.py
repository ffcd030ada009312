"""The plant's process and its clock: send state(t), wait for every input(t), advance.

As in an agent, the work is done on the network thread as messages arrive; the main thread watches the clock. The main
thread sends a step that had to wait: for its time, for a process that ends or starts, or for a slow observer. It
repeats messages without an answer. After the deadline it continues without the silent agents, and names them.
"""

from __future__ import annotations

import argparse
import functools
import logging
import secrets
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
import zenoh

from hedgerow.plant.clock import RESEND_AFTER_S, Clock
from hedgerow.plant.control import Control
from hedgerow.plant.inputs import Inputs
from hedgerow.plant.round_trips import Stopwatch
from hedgerow.plant.shards import Shards
from hedgerow.plant.tokens import Tokens
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.errors import DeadlineError
from hedgerow.topologies.paths import user_path
from hedgerow.wire import keys
from hedgerow.wire.child import run_child
from hedgerow.wire.codec import (
    decode_event,
    decode_input,
    decode_seen,
    encode_end,
    encode_event,
    encode_round_trips,
    encode_telemetry,
    kind_of,
    telemetry_bytes,
)
from hedgerow.wire.message import Buffer, End, Kind
from hedgerow.wire.runtime import LONG_BYTES, keep_memory
from hedgerow.wire.session import (
    Receiver,
    close,
    counts,
    direct,
    open_client,
    open_router,
    publisher,
    wait_for_listeners,
)
from hedgerow.wire.shared_rows import open_shared
from hedgerow.wire.stream import Outbox, rows_ahead

LOG = logging.getLogger("plant")
START_DEADLINE_S = 60.0
OBSERVER_DEADLINE_S = 60.0
END_DEADLINE_S = 5.0
REPORT_BYTES, REPORT_BYTES_PER_INCIDENCE = 2**16, 256
"""The maximum size of the final report of a shard.

It names two keys per peer, and a shard has at most as many peers as incidences.
"""
REPORT_DEADLINE_S = 2.0
"""The time that a running shard has for its final report, after END [s]."""


class Plant:
    """The process of the plant, from the first state to the end."""

    def __init__(
        self,
        truth: Truth,
        session: zenoh.Session,
        rate: float,
        deadline_s: float,
        start_s: float = START_DEADLINE_S,
        network: str = "",
        shared: str = "",
        memories: Mapping[int, str] | None = None,
    ) -> None:
        """Connect the plant.

        `shared` is the path of memory that the observer shares; without it, telemetry travels in messages. `memories`
        are those that the agents share, by shard, for states and inputs.

        `start_s` is the time that all processes have to join [s]; `network` is the fingerprint that each must have.
        """
        n, e = len(truth.ids), len(truth.edges)
        if telemetry_bytes(n, e) > LONG_BYTES:
            keep_memory()
        self.truth, self.network = truth, network
        self.number = secrets.randbelow(2**31)
        """The number of this plant, drawn at random, in its token and for the agents that it gives a place."""
        self._start_s = start_s
        self.world = World(truth)
        self.clock = Clock(rate)
        self._deadline_s = deadline_s
        self._ahead = rows_ahead(n, e)
        self._since = time.monotonic()
        """the time when state(t) became ready"""
        self.running = False
        self.over = False
        self.stopping = False
        self._failure: Exception | None = None
        self._elapsed_s = 0.0
        self._stopwatch = Stopwatch(len(truth.shards))
        self._farewell = b""
        self._lock = threading.RLock()
        self.changed = threading.Condition(self._lock)

        self._session = session
        self._telemetry = publisher(session, keys.TELEMETRY)
        # Queue fewer rows than the plant may send ahead: it would wait for an answer to rows that have not left.
        self._outbox = Outbox(self._telemetry.put, max(1, self._ahead // 2))
        self._send_row = self._outbox.send_soon if telemetry_bytes(n, e) <= LONG_BYTES else self._outbox.send
        self._shared = open_shared(shared, telemetry_bytes(n, e)) if shared else None
        if self._shared is not None:
            self._send_row = self._share_row
        elif shared:
            LOG.warning("%s: cannot be opened here; telemetry travels in messages", shared)
        self.shards = Shards(truth, self.world, session, self.report_event, memories or {})
        self._tokens = Tokens(len(self.shards.all), self.number, self._see)
        self._inputs = Inputs([len(one.nodes) for one in self.shards.all], [one.incidences for one in self.shards.all])
        self._receivers = [
            *(
                Receiver(session, keys.input_(p), functools.partial(self._take_input, p))
                for p in range(len(truth.shards))
            ),
            Receiver(session, keys.SEEN, self._take_seen),
        ]
        self._control = Control(self, session)
        # Declare the token before the look at the agents: agents of an earlier run then leave.
        self._own_token = session.liveliness().declare_token(keys.alive(keys.PLANT, self.number))
        self._alive = session.liveliness().declare_subscriber(keys.ALIVE, direct(self._take_alive), history=True)

    def run(self) -> None:
        """Watch the clock until the last step, a stop or a failure; raise DeadlineError after a deadline."""
        try:
            with self.changed:
                self._wait_for_agents()
            if not self.stopping:
                wait_for_listeners(
                    [self._telemetry, *(shard.state.publisher for shard in self.shards.all)], self._start_s
                )
            with self.changed:
                LOG.info("all %d agents are ready", len(self.shards.all))
                self.running = True
                self.clock.start()
                self._prepare()
                while self.running:
                    self.changed.wait(self._keep_time())
        finally:
            with self.changed:
                self.running = False  # in every case: the plant reports nothing after the end
            self._end()
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Start no further step; the run ends as it does after its last step."""
        with self.changed:
            self.stopping = True
            self.changed.notify_all()

    def close(self) -> None:
        """Leave the network."""
        close(self._session)

    # The clock: every method below runs with the lock of `changed` held.

    def _wait_for_agents(self) -> None:
        def all_alive() -> bool:
            ready = all(shard.alive for shard in self.shards.all)
            return self.stopping or (ready and not self._tokens.left_behind)

        by = time.monotonic() + self._start_s
        while not self.changed.wait_for(all_alive, min(RESEND_AFTER_S, max(0.0, by - time.monotonic()))):
            self._see_late_tokens()
            if time.monotonic() < by:
                continue
            if self._tokens.left_behind:
                who = ", ".join(sorted(self._tokens.left_behind)[:8])
                raise DeadlineError(
                    f"{who}: of a run before, still there after {self._start_s:g} s; end those processes"
                )
            late = [shard.name for shard in self.shards.all if not shard.alive]
            raise DeadlineError(f"{', '.join(late[:8])} not ready after {self._start_s:g} s; see their logs")

    def _prepare(self) -> None:
        """Make state(t) ready, and send it if it may leave; end if t is the last step."""
        world = self.world
        if self.stopping or world.t == self.truth.steps:
            self.running = False
            self.changed.notify_all()
            return
        self.shards.attend()
        self._since = time.monotonic()
        if self.shards.deserted:
            return
        world.begin()
        self._inputs.begin(world.t)
        self.shards.prepare()
        self.clock.held = True
        self._release()
        if self.clock.held:
            self.changed.notify_all()  # the main thread must wait for its time

    def _release(self) -> None:
        if self.clock.held and not self.shards.held_for and self._wait_s() <= 0:
            self.clock.sent()
            for shard in self.shards.all:
                shard.send(self.world.t)

    def _wait_s(self) -> float:
        """Return the time until state(t) may leave [s]: until its turn, or until the observer has caught up."""
        return RESEND_AFTER_S if len(self._outbox) > self._ahead else self.clock.wait_s(self.world.t)

    def _keep_time(self) -> float:
        """Do the work of the main thread; return the time until the next call [s]."""
        if self.stopping:
            self.running = False
            return 0.0
        self._outbox.tend()
        self._see_late_tokens()
        self.shards.call_the_lost()
        if self.shards.deserted:
            return self._look_for_anybody()
        if self.clock.held:
            self._release()
        if self.clock.held:
            self._check_hold()
            # A process that ends or returns wakes up this thread.
            return RESEND_AFTER_S if self.shards.held_for else min(max(self._wait_s(), 0.0), RESEND_AFTER_S)
        if self.shards.missing and self.clock.waited_s() > self._deadline_s:
            self._go_on_without(sorted(self.shards.missing))
        elif self.shards.missing and self.clock.repeat_is_due():
            LOG.info("step %d: repeated, still without shards %s", self.world.t, sorted(self.shards.missing))
            for shard in self.shards.all:
                shard.send(self.world.t)
        self._go_on()
        return 0.0 if self.clock.held else min(RESEND_AFTER_S, max(0.01, self._deadline_s - self.clock.waited_s()))

    def _look_for_anybody(self) -> float:
        """Continue at t once a lost shard is back; raise DeadlineError after the deadline."""
        if any(shard.found for shard in self.shards.all):
            self._prepare()
            self._go_on()
            return 0.0
        if time.monotonic() - self._since > START_DEADLINE_S:
            names = ", ".join(shard.name for shard in self.shards.all)
            raise DeadlineError(f"step {self.world.t}: {names}: no agent is back after {START_DEADLINE_S:g} s")
        return RESEND_AFTER_S

    def _check_hold(self) -> None:
        """Raise DeadlineError if state(t) waits too long for the observer or for a process."""
        t, now = self.world.t, time.monotonic()
        if len(self._outbox) > self._ahead and now - self._outbox.progress_at > OBSERVER_DEADLINE_S:
            raise DeadlineError(f"step {t}: the observer has taken in nothing for {OBSERVER_DEADLINE_S:g} s")
        if (held := self.shards.held_for) and now - self._since > START_DEADLINE_S:
            names = ", ".join(shard.name for shard in held)
            raise DeadlineError(f"step {t}: {names} neither gone nor back for {START_DEADLINE_S:g} s; see its log")

    def _go_on_without(self, late: Sequence[int]) -> None:
        waited = self.clock.waited_s()
        silent = [self.shards.all[p] for p in late]
        alive = [f"{shard.name} (alive: {'yes' if shard.alive else 'no'})" for shard in silent]
        if len(late) == sum(shard.fault is None and bool(shard.messages) for shard in self.shards.all):
            # No agent answers: the plant is cut off, or the network is gone.
            raise DeadlineError(
                f"step {self.world.t}: no input from {', '.join(alive)} for {waited:.1f} s; see its log"
            )
        for p, who in zip(late, alive, strict=True):
            LOG.warning("step %d: no input from %s for %.1f s", self.world.t, who, waited)
            self.shards.lose(p, f"no input from {who} for {waited:.1f} s")

    def _go_on(self) -> None:
        """Make all steps that are possible.

        Pass a failure to the main thread; otherwise it would end in Zenoh's log.
        """
        try:
            while self.running and not (self.clock.held or self.shards.missing or self.shards.deserted):
                self._advance()
        except Exception as error:
            self._failure, self.running = error, False
            self.changed.notify_all()

    def _advance(self) -> None:
        """Act on the complete inputs of t, start t + 1, and only then read the rest of the messages and report t."""
        self.world.advance(self._inputs.u())
        self._elapsed_s = time.monotonic() - self.clock.began
        report_times = self._stopwatch.end_step()
        self._prepare()
        # The states of t + 1 are on their way, and the agents compute meanwhile.
        row = self.world.account(*self._inputs.rest())
        if self.running:
            self.world.look_ahead()
        self._send_row(*encode_telemetry(row, self.world.whole))
        if report_times:
            self._send_round_trips()

    def _share_row(self, *row: Buffer) -> None:
        """Write a row into the shared memory, and send its place; send the row if all places are in use."""
        shared = self._shared
        if shared is not None and len(self._outbox) < shared.rows:
            self._outbox.send_soon(shared.write(self.world.t, row))
        else:
            self._outbox.send(*row)

    def report_event(self, event: str, **details: Any) -> None:
        """Report an event of this step to the observer."""
        self._outbox.send(encode_event(self.world.t, {"event": event, **details}))

    def _send_round_trips(self) -> None:
        if (times := self._stopwatch.take_out(self.world.t - 1)) is not None:
            self._outbox.send(encode_round_trips(times))

    def _end(self) -> None:
        """Send END, and wait until the observer has all telemetry and the message counts."""
        end = End(self.world.t, self.world.x, self._elapsed_s, self.world.links.forgotten)
        with self.changed:
            self.over = True
            self._send_round_trips()
            self._farewell = encode_end(end._replace(x=np.empty(0)))
            for shard in self.shards.all:
                shard.state.put(self._farewell)
            self.changed.wait_for(
                lambda: all(shard.final_report or not shard.ready for shard in self.shards.all), REPORT_DEADLINE_S
            )
            counted = counts([shard.state for shard in self.shards.all], self._receivers)
            counted["sent"][keys.TELEMETRY] = self._outbox.sent + 1  # this event included
            self.report_event(
                "counts",
                plant=counted,
                shards=[shard.final_report for shard in self.shards.all],
            )
            self._outbox.send(encode_end(end))
            by = time.monotonic() + END_DEADLINE_S
            while self._outbox and (left := by - time.monotonic()) > 0:
                self._outbox.tend()
                self.changed.wait(min(left, RESEND_AFTER_S))
        refused = sum(receiver.refused for receiver in self._receivers)
        LOG.info("end at step %d of %d, %d messages refused", self.world.t, self.truth.steps, refused)

    @property
    def missing(self) -> list[str]:
        """Return the names of the shards that have sent no input(t) for some time."""
        late = not self.clock.held and self.clock.waited_s() > RESEND_AFTER_S
        return [self.shards.all[p].name for p in sorted(self.shards.missing)] if late else []

    # Incoming messages: each method below takes the lock.

    def _take_input(self, p: int, message: bytes) -> None:
        with self._lock:  # `with` of the condition costs three times as much
            shard, missing = self.shards.all[p], self.shards.missing
            if p in missing and self.running:
                if self._inputs.take(p, self._at_its_place(p, message)):
                    shard.returning = False
                    self._stopwatch.now[p] = time.monotonic() - self.clock.sent_at
                    missing.discard(p)
                    if not missing:
                        self._go_on()
            elif self.over and kind_of(message) == Kind.EVENT:
                most = REPORT_BYTES + REPORT_BYTES_PER_INCIDENCE * shard.incidences
                shard.final_report = shard.final_report or decode_event(message, most)
                shard.state.put(self._farewell)
                self.changed.notify_all()
            else:
                if kind_of(message) != Kind.PLACE:  # a late one is not read: its row may hold another step
                    decode_input(message, len(shard.nodes), shard.incidences)
                if shard.fault is not None:
                    shard.back = True
                    self.changed.notify_all()

    def _at_its_place(self, p: int, message: bytes) -> bytes | memoryview:
        memory = self.shards.all[p].memory
        return message if memory is None or kind_of(message) != Kind.PLACE else memory.view(message)

    def _take_seen(self, message: bytes) -> None:
        with self.changed:
            self._outbox.seen(decode_seen(message))
            if self.running and self.clock.held:
                self._release()
                self._go_on()
            elif not self.running:
                self.changed.notify_all()

    def _take_alive(self, sample: zenoh.Sample) -> None:
        if (token := self._tokens.read(str(sample.key_expr))) is not None:
            with self.changed:
                if self._tokens.take(token, sample.kind == zenoh.SampleKind.PUT):
                    self.changed.notify_all()

    def _see_late_tokens(self) -> None:
        if self._tokens.take_late():
            self.changed.notify_all()

    def _see(self, p: int, life: int, there: bool) -> None:
        """Record that the token of a life appeared or vanished."""
        if life > max(0, self.shards.all[p].life):  # the plant may be the only witness of the end of a separate process
            self.died(p, life - 1)
        self.shards.see(p, life, there)

    def died(self, p: int, life: int) -> None:
        """Record the end of a shard's process, reported by the program that started it."""
        self.shards.end(p, life, self.running)
        self._go_on()
        self.changed.notify_all()


def options() -> argparse.ArgumentParser:
    """Return the parser of the arguments."""
    parser = argparse.ArgumentParser(prog="python -m hedgerow.plant", description=main.__doc__)
    parser.add_argument("truth", type=user_path, help="the true network, a .npz file")
    parser.add_argument("--namespace", required=True, help="the Zenoh namespace of the run")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", help="be the router of the run, on a Zenoh endpoint")
    where.add_argument("--connect", help="the router, a Zenoh endpoint")
    parser.add_argument("--rate", type=float, default=0.0, help="steps per second; 0 for as fast as possible")
    parser.add_argument(
        "--deadline", type=float, default=10.0, help="seconds to wait for an input before the step is made without it"
    )
    parser.add_argument("--start", type=float, default=START_DEADLINE_S, help="time for all processes to join [s]")
    parser.add_argument("--network", default="", help="the fingerprint that each joining process must have")
    parser.add_argument("--credentials", type=user_path, help="the folder with its certificate")
    parser.add_argument("--shared", default="", help="memory that it shares with the observer")
    parser.add_argument(
        "--memory",
        nargs=2,
        action="append",
        default=[],
        metavar=("SHARD", "PATH"),
        help="memory that it shares with a shard",
    )
    return parser


def run(known: argparse.Namespace) -> NoReturn:
    """Run the plant with these arguments."""

    def body() -> None:
        # Open the router first: the other processes wait for it.
        if known.listen:
            session = open_router(known.listen, known.namespace, known.credentials)
        else:
            session = open_client(known.connect, known.namespace, known.credentials)
        memories = {int(p): path for p, path in known.memory}
        plant = Plant(
            Truth.read(known.truth),
            session,
            known.rate,
            known.deadline,
            known.start,
            known.network,
            known.shared,
            memories,
        )
        try:
            plant.run()
        finally:
            plant.close()

    run_child(body)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """`python -m hedgerow.plant TRUTH --namespace RUN --listen ENDPOINT`: run the world to its last step."""
    run(options().parse_args(arguments))
