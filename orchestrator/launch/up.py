"""A run over Zenoh: one plant, agent processes, a router between them, and the observer here."""

from __future__ import annotations

import contextlib
import functools
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from hedgerow.agents.law_source import source_digest
from hedgerow.orchestrator.ground.assignment import Layout, places, process_name, truth_of, views_of
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.launch.certificates import host_of
from hedgerow.orchestrator.launch.comparison import compare
from hedgerow.orchestrator.launch.control import ask, tell_died
from hedgerow.orchestrator.launch.endpoints import Connection, wire
from hedgerow.orchestrator.launch.external_agents import External, Meeting, configs
from hedgerow.orchestrator.launch.fault_changes import with_end, with_fault, with_loss
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.plant_event import checked
from hedgerow.orchestrator.launch.ray_agents import Fleet, OnRay
from hedgerow.orchestrator.launch.recording import Recording, Watching
from hedgerow.orchestrator.launch.supervisor import Dead, Processes, cause
from hedgerow.orchestrator.metrics.deaths import survivors
from hedgerow.orchestrator.metrics.message_audit import audit, observed
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.runs.round_trips import line
from hedgerow.orchestrator.views.rerun.viewer import Viewer
from hedgerow.orchestrator.views.screen import Screen
from hedgerow.topologies.errors import Code, Exit, HedgerowError
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.child import USER_ERROR
from hedgerow.wire.codec import (
    Kind,
    MessageError,
    Telemetry,
    decode_end,
    decode_event,
    decode_telemetry,
    decode_trips,
    encode_seen,
    kind_of,
    telemetry_bytes,
)
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.handshake import room
from hedgerow.wire.limits import need_open_files
from hedgerow.wire.runtime import LONG_BYTES, keep_memory
from hedgerow.wire.session import (
    CONNECT_TIMEOUT_S,
    Receiver,
    RefusedError,
    Sender,
    WireError,
    close,
    has_router,
    open_client,
)
from hedgerow.wire.stream import Inbox, rows_ahead

ROUTER_FILES = 24
"""Open files of a plant that is the router, besides one per agent process."""
TICK_S = 0.2
"""How often telemetry is taken in: in batches, off the loop's path."""
WAKE_ROWS = 512
"""Rows that are taken in at once, or half of those that the plant waits for, whichever is less."""
PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S = 5.0, 1.0
"""How long the plant has to end by itself once told, and the agents after it: they have nothing to lose."""
ROUTER_GONE_S = 3.0
"""How long a router of the user's may be gone where no step is to be lost: before the first, and after the last."""
LOOK_S = 1.0
"""How long our own session is tried for before we look whether there is still somebody to meet."""


@dataclass(frozen=True)
class Options:
    """How a network is run; nothing here changes its trajectory, unless an agent is late by more than the deadline."""

    rate: float = 0.0
    """steps per second, 0 for as fast as possible"""
    deadline_s: float = 10.0
    """how long the plant waits for an input before it goes on without that agent"""
    router: str | None = None
    """an existing router's endpoint; None for one of our own"""
    keys: Path | None = None
    """credentials made beforehand, for a secure run over a router that is there"""
    external: External | None = None
    """who is started elsewhere, if anybody"""
    ray: OnRay | None = None
    """where Ray starts them"""
    watching: Watching = field(default_factory=Watching)
    verify: bool = False
    """compare with the in-process reference afterwards"""


class Network:
    """The processes of one run and what is heard of them, from launch to verdict."""

    def __init__(
        self,
        topology: Topology,
        folder: RunFolder,
        shards: Layout,
        options: Options,
        screen: Screen,
        fork_client: ForkClient,
        began: float,
    ) -> None:
        """`began` is when the command was given, by time.monotonic(): the first step is counted from there."""
        self._fork_client = fork_client
        self._topology, self._folder, self._shards, self._options = topology, folder, shards, options
        self._screen, self._began = screen, began
        self._ending = Ending(run=folder.name, engine="zenoh", processes=len(shards))
        self._inbox = Inbox()
        if telemetry_bytes(len(topology.ids), len(topology.edges)) > LONG_BYTES:
            keep_memory()
        self._wake_rows = min(WAKE_ROWS, rows_ahead(len(topology.ids), len(topology.edges)) // 2)
        self._wake = threading.Event()
        """something should be looked at before the next tick"""
        self._first_at: float | None = None
        self._repeated = False
        """the plant has said again what we have"""
        self._word: Callable[[], dict[str, Any] | None] = lambda: None
        """what we said and heard, by key"""
        self._views = views_of(topology, shards, source_digest(topology.law))
        self._connection = self._wire()
        self._meeting: Meeting | None = None
        """with those who are started elsewhere"""
        self._fleet: Fleet | None = None
        """those of them whom Ray has started"""
        self._asked_at: float | None = None
        """when the plant was first asked to stop"""
        self._answered = False
        self._routed_at = time.monotonic()
        """when we last had a router"""
        self._cut_off = False
        """it has been gone for too long"""
        self._down: list[Dead] = []
        self._slow = ""
        """the law that an agent was busy with at the end"""
        self._refused = 0
        """messages on `telemetry` that no plant sends"""
        self.interrupted = False
        """the user asked for the end"""

    def _wire(self) -> Connection:
        secure, options = self._topology.secure, self._options
        if options.external is None:
            return wire(self._folder, secure, options.router, options.keys, places(self._views))
        connection = options.external.connection(options.router, options.keys)
        if secure and options.keys is None and options.ray is not None:
            return connection.with_keys_of_its_own(self._folder, host_of(options.ray.endpoint))
        return connection

    def run(
        self,
        on_first_step: Callable[[float], None] = lambda _: None,
        at_last: contextlib.AbstractContextManager[object] = contextlib.nullcontext(),  # noqa: B008 (it has no state)
    ) -> Verdict:
        """Launch, observe until the end or an interrupt, clean up, and judge.

        `on_first_step` is called with the seconds from the command to the first step, once it is done. `at_last` is
        left when all is over, while a signal still asks for no more than the end.
        """
        dead: list[Dead] = []
        self._fork_client.on_end = self._wake.set
        # Said before any of it exists: whenever we are killed, nothing of it stays.
        self._fork_client.leave_no([registry.entry_path(self._folder.name), *self._connection.traces])
        with Interrupts(self._wake.set) as interrupts, at_last, self._announced():
            names = [process_name(view) for view in self._views]
            run = Recording(self._topology, self._folder, self._options.watching, self._ending, names)
            try:
                with contextlib.ExitStack() as stack:
                    processes, session = self._launch(stack, interrupts)
                    run.tell_faults()
                    try:
                        self._observe(run, session, processes, interrupts, on_first_step)
                        if not self._cut_off:  # else nobody of them has been told
                            processes.wait(PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S)
                    finally:
                        dead = processes.dead()
                        self._ending.mistaken = any(one.code == USER_ERROR for one in dead)
                        self._slow = processes.slow_law(run.observer.next_step)
                        self._ending.restarts = processes.restarts
                        self._down = processes.down
                        self._ending.down = [str(one) for one in processes.down]
                        known = (run.topology, self._shards, processes.deaths, self._ending.losses)
                        self._ending.survivors = survivors(*known, run.observer.next_step)
                        if self._fleet is not None:
                            self._ending.restarts += self._fleet.restarts
                            self._ending.down += self._fleet.down
            except (KeyboardInterrupt, SystemExit):
                raise
            except BaseException as error:  # a panic of a Rust library is no Exception
                self._ending.end_by(error, self._folder.logs / "orchestrator.log")
            self.interrupted = interrupts.count > 0
            self._explain(run, dead)
            if self._options.verify and not self._ending.stopped:
                self._ending.comparison = compare(run)
            verdict = run.close()
            self._warn(run)
            if told := line(verdict.content["round_trips"] or {}):
                self._screen.say(told)
            self._screen.verdict(verdict, self._folder.path)
            if run.viewer is not None:
                self._serve(run.viewer, interrupts)
        return verdict

    def _serve(self, viewer: Viewer, interrupts: Interrupts) -> None:
        """Keep a web page until Ctrl-C if the command asks for it; a page that others open stays in any case."""
        stays = self._options.watching.keep or viewer.door is not None
        if viewer.link is not None and stays and not interrupts.count:
            self._screen.say(f"{viewer.link} stays until Ctrl-C")
            self._wake.clear()
            while not interrupts.count:
                self._wake.wait(TICK_S)
        viewer.end()

    def _announced(self) -> contextlib.AbstractContextManager[Path]:
        connection = self._connection
        return registry.announced(
            self._folder.name,
            self._folder.path,
            connection.endpoint,
            connection.namespace,
            connection.credentials,
            connection.traces,
        )

    def _launch(self, stack: contextlib.ExitStack, interrupts: Interrupts) -> tuple[Processes, zenoh.Session]:
        """Processes and our own session; each is undone when `stack` closes, however that comes."""
        connection = self._connection
        stack.enter_context(connection.laid(places(self._views)))
        stack.callback(self._fork_client.clear)
        processes = Processes(self._fork_client, self._folder, connection)
        if connection.listens:  # without this, agents that the router cannot accept would be restarted for a minute
            need_open_files(len(self._views) + ROUTER_FILES, f"a plant with {len(self._views)} agent processes")
        external = self._options.external
        # Nobody need be started for a router that is not there.
        session = None if connection.listens else self._connect(processes, interrupts, stack)
        if external is None or not external.plant:
            if session is not None:  # nor for one where another network runs
                stack.enter_context(room(session, connection.namespace, self._screen.say, lambda: interrupts.count > 0))
                if interrupts.count:
                    raise HedgerowError(interrupts.name)
            truth = truth_of(self._topology, self._shards)
            processes.start_plant(truth, self._options.rate, self._options.deadline_s, external)
        for view in self._views:
            if external is None or view.shard not in external:
                processes.start_agent(view)
        session = session or self._connect(processes, interrupts, stack)
        pids = processes.wait_until_started()
        if external is not None:
            self._screen.say(
                f"waiting for {external} at {external.listen or connection.endpoint}, {connection.namespace}"
            )
            self._meeting = Meeting(external, session, self._folder.logs / f"{keys.PLANT}.log")
            stack.enter_context(self._meeting.watched())
            if external.plant:
                self._meeting.introduce()
        if external is not None and self._options.ray is not None:
            told = configs(self._topology, self._shards, self._options.ray.endpoint, connection.namespace)
            self._fleet = Fleet(self._options.ray, self._folder, self._wake.set, self._screen.say)
            own = [Credentials.read(where) if (where := connection.of(one.process)) else None for one in told[1:]]
            stack.enter_context(self._fleet.placed([*zip(told[1:], own, strict=True)], external.wait_s))
        self._folder.event(
            "start", engine="zenoh", endpoint=connection.endpoint, namespace=connection.namespace, pids=pids
        )
        return processes, session

    def _connect(self, processes: Processes, interrupts: Interrupts, stack: contextlib.ExitStack) -> zenoh.Session:
        """Our own session while `stack` lasts; HedgerowError if no router comes in time, or who would be it died."""
        connection, external = self._connection, self._options.external
        wait_s = external.wait_s if external and external.plant else CONNECT_TIMEOUT_S
        by = time.monotonic() + wait_s
        own = Credentials.read(connection.own) if connection.own else None  # once: what is wrong with them is told once
        while True:
            try:
                session = open_client(connection.endpoint, connection.namespace, own, LOOK_S)
                stack.callback(close, session)
                return session
            except RefusedError:
                raise
            except WireError as error:
                dead = processes.dead()
                if interrupts.count or dead:
                    code = Code.CRASH if any(one.code == Exit.CRASH for one in dead) else None
                    raise HedgerowError(interrupts.name or cause(dead), code=code) from None
                if time.monotonic() > by:
                    raise WireError(f"{error} (tried for {wait_s:g} s)") from None

    def _observe(
        self,
        run: Recording,
        session: zenoh.Session,
        processes: Processes,
        interrupts: Interrupts,
        on_first_step: Callable[[float], None],
    ) -> None:
        """Take telemetry in, batch by batch, until the plant's END or until there is nobody to wait for."""
        receiver, seen = Receiver(session, keys.TELEMETRY, self._put), Sender(session, keys.SEEN)
        self._word = functools.partial(observed, seen, receiver, self._inbox)
        with contextlib.closing(receiver):
            while run.observer.end is None:
                self._wake.wait(self._tick_s(processes))
                self._wake.clear()
                if self._ending.first_step_s is None and self._first_at is not None:
                    self._ending.first_step_s = self._first_at - self._began
                    self._folder.event("first_step", after_s=round(self._ending.first_step_s, 3))
                    on_first_step(self._ending.first_step_s)
                for refused in self._meeting.refused() if self._meeting else ():
                    self._screen.say(refused)
                nobody_left = (
                    processes.ended(keys.PLANT)
                    or self._asked_long_ago()
                    or self._is_cut_off(session)
                    or self._nobody_comes()
                )
                something = self._take_in(run, processes)
                if something or self._repeated:
                    self._repeated = False
                    seen.put(encode_seen(self._inbox.last))
                elif nobody_left:
                    return
                for happened in processes.tend(functools.partial(tell_died, session, timeout_s=TICK_S)):
                    self._folder.event(**happened)
                    if happened["kind"] == "down":
                        self._screen.say(f"{happened['process']} stays down: {happened['how']}")
                    if happened.get("code") == Exit.CRASH:
                        self._screen.say(happened["how"])
                        self._ending.crashed = True
                        self._ending.stopped = self._ending.stopped or happened["how"]
                # Without one of our processes the first step never happens.
                missed = processes.failing if self._ending.first_step_s is None else []
                if interrupts.count or processes.dead() or missed:
                    self._ask_to_stop(session, interrupts.name or (cause(missed) if missed else ""))

    def _tick_s(self, processes: Processes) -> float:
        due = processes.next_due
        return TICK_S if due is None else min(TICK_S, max(0.0, due - time.monotonic()))

    def _put(self, whole: bytes) -> None:
        """Take a batch, on the network thread, and wake up for what should not wait for the next tick."""
        messages = self._inbox.put(whole)
        if not messages:  # what we said to have seen was lost
            self._repeated = True
        kinds = set(map(kind_of, messages))
        if Kind.TELEMETRY in kinds and self._first_at is None:
            self._first_at = time.monotonic()
            self._wake.set()
        elif kinds & {Kind.EVENT, Kind.END} or len(self._inbox) >= self._wake_rows:
            self._wake.set()

    def _take_in(self, run: Recording, processes: Processes) -> bool:
        """Observe what has come, in its order; whether anything had."""
        messages = self._inbox.drain()
        n, e = len(self._topology.ids), len(self._topology.edges)
        for kind, some in itertools.groupby(messages, kind_of):
            match kind:
                case Kind.TELEMETRY:
                    self._take_rows(run, [decode_telemetry(message, n, e) for message in some])
                case Kind.EVENT:
                    for message in some:
                        try:
                            event = checked(decode_event(message), len(self._shards), len(run.topology.faults))
                        except MessageError as error:
                            self._refuse(error)
                        else:
                            self._take_event(run, processes, event)
                case Kind.TRIPS:
                    for message in some:
                        run.take_trips(decode_trips(message, len(self._shards)))
                case Kind.END:
                    run.finish(decode_end(next(some), n))
        return bool(messages)

    def _refuse(self, error: MessageError) -> None:
        """Report the first message on `telemetry` that no plant sends; the run goes on without it."""
        if not self._refused:
            self._screen.say(f"{keys.TELEMETRY}: refused: {error}; somebody else writes there")
            self._folder.event("refused_message", why=str(error))
        self._refused += 1

    def _take_rows(self, run: Recording, rows: list[Telemetry]) -> None:
        unseen = run.viewer is None
        for some in range(0, len(rows), run.rows_at_once):
            if (batch := run.take(rows[some : some + run.rows_at_once])) is not None:
                self._screen.progress(batch)
        if unseen and run.viewer is not None:
            self._screen.say(f"watch it at {run.viewer.link or run.viewer.url}")
        self._warn(run)

    def _take_event(self, run: Recording, processes: Processes, event: dict[str, Any]) -> None:
        """Act on what the plant says between two steps, write it down, and keep the resolved file true."""
        topology, step = run.topology, event["step"]
        details = {key: value for key, value in event.items() if key != "event"}
        if "fault" in event:  # people count from 1
            details["fault"] += 1
        if event["event"] != "heard":  # verdict.json has it
            self._folder.event(event["event"], **details)
        match event["event"]:
            case "heard":
                self._ending.audit = audit(places(self._views), event, self._word())
            case "kill":
                processes.kill(event["shard"], event["life"], event["restart"])
            case "revive":
                processes.revive(event["shard"])
            case "lost":
                nodes = [topology.ids[k] for k in self._shards[event["shard"]]]
                self._ending.losses.add(event["fault"])
                run.change(with_loss(topology, event["shard"], nodes, step))
                slow = processes.slow_law(step, event["shard"])
                why = f"{event['cause']}; {slow}" if slow else event["cause"]
                self._say(run, f"step {step}: going on without {event['who']}: {why}", "WARN", step)
            case "refused":
                self._screen.say(f"{event['who']} is refused: {event['cause']}")
            case "back":
                run.change(with_end(topology, event["fault"], event["at"]))
                self._say(run, f"step {event['at']}: {event['who']} is back", "INFO", step)
            case "fault":
                run.change(with_fault(topology, event["entry"]))
                self._say(run, f"step {event['at']}: fault {event['fault'] + 1} begins", "WARN", step)
            case "heal":
                run.change(with_end(topology, event["fault"], event["at"]))
                self._say(run, f"step {event['at']}: fault {event['fault'] + 1} ends", "INFO", step)

    def _warn(self, run: Recording) -> None:
        """Say what is wrong with the viewer."""
        while run.warnings:
            self._screen.say(run.warnings.popleft())

    def _say(self, run: Recording, text: str, level: str, step: int) -> None:
        self._screen.say(text)
        run.note(text, level, step)

    def _ask_to_stop(self, session: zenoh.Session, why: str) -> None:
        """Ask the plant to end the run, again at every tick until it answers: it may not have begun yet."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()
            self._ending.stopped = why
            self._folder.event("stopping", why=why or "a process died")
        if not self._answered:
            with contextlib.suppress(WireError):
                ask(session, "stop", timeout_s=1.0)
                self._answered = True

    def _asked_long_ago(self) -> bool:
        return self._asked_at is not None and time.monotonic() - self._asked_at > PLANT_END_DEADLINE_S

    def _is_cut_off(self, session: zenoh.Session) -> bool:
        """Whether a router of the user's is gone for too long; processes elsewhere are waited for longer (Meeting)."""
        now = time.monotonic()
        if self._connection.listens or self._meeting is not None or has_router(session):
            self._routed_at = now
            return False
        in_steps = self._first_at is not None and self._asked_at is None
        patience_s = max(ROUTER_GONE_S, self._options.deadline_s) if in_steps else ROUTER_GONE_S
        if now - self._routed_at > patience_s:
            self._cut_off = True
            gone = f"the router at {self._connection.endpoint} is gone: not seen for {patience_s:g} s"
            self._ending.stopped = self._ending.stopped or gone
        return self._cut_off

    def _nobody_comes(self) -> bool:
        """Whether those who are started elsewhere are not there, and will not be."""
        begun = self._ending.first_step_s is not None
        over = self._meeting is not None and self._meeting.is_over(begun)
        if over and self._meeting is not None:
            self._ending.stopped = self._ending.stopped or self._meeting.reason
        if self._fleet is not None and self._fleet.reason and not begun:
            over, self._ending.stopped = True, self._ending.stopped or self._fleet.reason
        return over

    def _explain(self, run: Recording, dead: list[Dead]) -> None:
        """Why the run ended before its last step, if it did."""
        done = run.observer.end.t if run.observer.end is not None else run.observer.next_step
        if dead:
            self._folder.event("processes_died", processes=[str(one) for one in dead])
        self._ending.crashed |= any(one.code == Exit.CRASH for one in [*dead, *self._down])
        if done < self._topology.steps:
            reason = self._ending.stopped or (cause(dead) if dead else "stopped on request")
            if self._slow and "no input from" in reason:
                reason += f"; {self._slow}"
            self._ending.stopped = f"stopped at step {done}: {reason}"
