"""A run over Zenoh: one plant, agent processes, a router between them, and the observer here."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from orchestrator import registry
from orchestrator.assign import Layout, places, truth_of, views_of
from orchestrator.audit import audit
from orchestrator.control import ask
from orchestrator.course import with_end, with_fault, with_loss
from orchestrator.external import External, Meeting
from orchestrator.folder import RunFolder
from orchestrator.interrupts import Interrupts
from orchestrator.nursery import Nursery
from orchestrator.run import Run, Watching
from orchestrator.screen import Screen
from orchestrator.simulate import equals_reference
from orchestrator.supervise import Dead, Processes, cause
from orchestrator.verdict import Ending, Verdict
from orchestrator.viewer import Viewer
from orchestrator.wiring import wire
from topologies.errors import HedgerowError
from topologies.schema import Topology
from wire import keys
from wire.codec import Kind, Telemetry, decode_end, decode_event, decode_telemetry, encode_seen, kind_of
from wire.session import CONNECT_TIMEOUT_S, WireError, close, open_client, publisher, subscriber
from wire.stream import Inbox

TICK_S = 0.2
"""How often telemetry is taken in: in batches, off the loop's path."""
WAKE_ROWS = 512
PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S = 5.0, 1.0
"""How long the plant has to end by itself once told, and the agents after it: they have nothing to lose."""


@dataclass(frozen=True)
class Options:
    """How a network is run; nothing here changes its trajectory."""

    rate: float = 0.0
    """steps per second, 0 for as fast as possible"""
    deadline_s: float = 10.0
    """how long the plant waits for an input before it gives up"""
    router: str | None = None
    """an existing router's endpoint; None for one of our own"""
    keys: Path | None = None
    """credentials made beforehand, for a secure run over a router that is there"""
    external: External | None = None
    """who is started elsewhere, if anybody"""
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
        nursery: Nursery,
        began: float,
    ) -> None:
        """`began` is when the command was given, by time.monotonic(): the first step is counted from there."""
        self._nursery = nursery
        self._topology, self._folder, self._shards, self._options = topology, folder, shards, options
        self._screen, self._began = screen, began
        self._ending = Ending(run=folder.name, engine="zenoh", processes=len(shards))
        self._inbox = Inbox()
        self._wake = threading.Event()
        """something should be looked at before the next tick"""
        self._first_at: float | None = None
        self._repeated = False
        """the plant has said again what we have"""
        self._views = views_of(topology, shards)
        self._wiring = (
            options.external.wiring(options.router)
            if options.external
            else wire(folder, topology.secure, options.router, options.keys, places(self._views))
        )
        self._meeting: Meeting | None = None
        """with those who are started elsewhere"""
        self._asked_at: float | None = None
        """when the plant was first asked to stop"""
        self._answered = False
        self.interrupted = False
        """the user asked for the end"""

    def run(self, on_first_step: Callable[[float], None] = lambda _: None) -> Verdict:
        """Launch, observe until the end or an interrupt, clean up, and judge.

        `on_first_step` is called with the seconds from the command to the first step, once it is done.
        """
        dead: list[Dead] = []
        self._nursery.on_end = self._wake.set
        with Interrupts(self._wake.set) as interrupts, self._announced() as listed:
            run = Run(self._topology, self._folder, self._options.watching, self._ending)
            try:
                with contextlib.ExitStack() as stack:
                    processes, session = self._launch(stack, listed)
                    run.tell_faults()
                    try:
                        self._observe(run, session, processes, interrupts, on_first_step)
                        processes.wait(PLANT_END_DEADLINE_S, AGENTS_END_DEADLINE_S)
                    finally:
                        dead = processes.dead()
                        self._ending.restarts = processes.restarts
                        self._ending.down = [str(one) for one in processes.down]
            except (HedgerowError, OSError) as error:
                self._ending.stopped = str(error)
            self.interrupted = interrupts.count > 0
            self._explain(run, dead)
            if self._options.verify and not self._ending.stopped:
                run.close_tables()
                self._ending.reference_equal = equals_reference(run.topology, self._folder)
            verdict = run.close()
            self._warn(run)
            self._screen.verdict(verdict, self._folder.path)
            if run.viewer is not None:
                self._serve(run.viewer, interrupts)
        return verdict

    def _serve(self, viewer: Viewer, interrupts: Interrupts) -> None:
        """Keep a web page up until Ctrl-C, where somebody can press that."""
        stays = self._screen.interactive or viewer.door is not None
        if viewer.link is not None and stays and not interrupts.count:
            self._screen.say(f"{viewer.link} stays until Ctrl-C")
            self._wake.clear()
            while not interrupts.count:
                self._wake.wait(TICK_S)
        viewer.end()

    def _announced(self) -> contextlib.AbstractContextManager[Path]:
        wiring = self._wiring
        return registry.announced(
            self._folder.name, self._folder.path, wiring.endpoint, wiring.namespace, wiring.credentials
        )

    def _launch(self, stack: contextlib.ExitStack, listed: Path) -> tuple[Processes, zenoh.Session]:
        """Processes and our own session; each is undone when `stack` closes, however that comes."""
        wiring = self._wiring
        stack.enter_context(wiring.laid(places(self._views)))
        stack.callback(self._nursery.clear)
        # Should we be killed while nobody else of the run is left: the plant sees to it otherwise.
        self._nursery.leave_no([listed, *wiring.files])
        processes = Processes(self._nursery, self._folder, wiring)
        external = self._options.external
        if external is None or not external.plant:
            truth = truth_of(self._topology, self._shards)
            processes.start_plant(truth, self._options.rate, self._options.deadline_s, listed, external)
        for view in self._views:
            if external is None or view.shard not in external.shards:
                processes.start_agent(view)
        wait_s = external.wait_s if external and external.plant else CONNECT_TIMEOUT_S
        session = open_client(wiring.endpoint, wiring.namespace, wiring.own, wait_s)
        stack.callback(close, session)
        pids = processes.wait_until_started()
        if external is not None:
            self._screen.say(f"waiting for {external} at {external.listen or wiring.endpoint}, {wiring.namespace}")
            self._meeting = Meeting(external, session)
            stack.enter_context(self._meeting.watched())
            if external.plant:
                self._meeting.introduce()
        self._folder.event("start", engine="zenoh", endpoint=wiring.endpoint, namespace=wiring.namespace, pids=pids)
        return processes, session

    def _observe(
        self,
        run: Run,
        session: zenoh.Session,
        processes: Processes,
        interrupts: Interrupts,
        on_first_step: Callable[[float], None],
    ) -> None:
        """Take telemetry in, batch by batch, until the plant's END or until there is nobody to wait for."""

        def tell_died(shard: int, life: int) -> bool:
            with contextlib.suppress(WireError):
                ask(session, "died", {"shard": shard, "life": life}, timeout_s=TICK_S)
                return True
            return False

        with subscriber(session, keys.TELEMETRY, self._put):
            seen = publisher(session, keys.SEEN)
            while run.observer.end is None:
                self._wake.wait(self._tick_s(processes))
                self._wake.clear()
                if self._ending.first_step_s is None and self._first_at is not None:
                    self._ending.first_step_s = self._first_at - self._began
                    self._folder.event("first_step", after_s=round(self._ending.first_step_s, 3))
                    on_first_step(self._ending.first_step_s)
                nobody_left = processes.ended(keys.PLANT) or self._asked_long_ago() or self._nobody_comes()
                something = self._take_in(run, processes)
                if something or self._repeated:
                    self._repeated = False
                    seen.put(encode_seen(self._inbox.last))
                elif nobody_left:
                    return
                for happened in processes.tend(tell_died):
                    self._folder.event(**happened)
                if interrupts.count or processes.dead():
                    self._ask_to_stop(session, interrupts.name)

    def _tick_s(self, processes: Processes) -> float:
        due = processes.next_due
        return TICK_S if due is None else min(TICK_S, max(0.0, due - time.monotonic()))

    def _put(self, whole: bytes) -> None:
        """Take a message, on the network thread, and wake up for what should not wait for the next tick."""
        message = self._inbox.put(whole)
        if message is None:  # what we said to have seen was lost
            self._repeated = True
        kind = kind_of(message) if message is not None else -1
        if kind == Kind.TELEMETRY and self._first_at is None:
            self._first_at = time.monotonic()
            self._wake.set()
        elif kind in (Kind.EVENT, Kind.END) or len(self._inbox) >= WAKE_ROWS:
            self._wake.set()

    def _take_in(self, run: Run, processes: Processes) -> bool:
        """Observe what has come, in its order; whether anything had."""
        messages = self._inbox.drain()
        n, e = len(self._topology.ids), len(self._topology.edges)
        for kind, some in itertools.groupby(messages, kind_of):
            match kind:
                case Kind.TELEMETRY:
                    self._take_rows(run, [decode_telemetry(message, n, e) for message in some])
                case Kind.EVENT:
                    for message in some:
                        self._take_event(run, processes, decode_event(message))
                case Kind.END:
                    run.finish(decode_end(next(some), n))
        return bool(messages)

    def _take_rows(self, run: Run, rows: list[Telemetry]) -> None:
        unseen = run.viewer is None
        for some in range(0, len(rows), run.rows_at_once):
            self._screen.progress(run.take(rows[some : some + run.rows_at_once]))
        if unseen and run.viewer is not None:
            self._screen.say(f"watch it at {run.viewer.link or run.viewer.url}")
        self._warn(run)

    def _take_event(self, run: Run, processes: Processes, event: dict[str, Any]) -> None:
        """Act on what the plant says between two steps, write it down, and keep the resolved file true."""
        topology, step = run.topology, event["step"]
        details = {key: value for key, value in event.items() if key != "event"}
        if "fault" in event:  # people count from 1
            details["fault"] += 1
        if event["event"] != "heard":  # verdict.json has it
            self._folder.event(event["event"], **details)
        match event["event"]:
            case "heard":
                self._ending.audit = audit(places(self._views), event)
            case "kill":
                processes.kill(event["shard"], event["life"], event["restart"])
            case "revive":
                processes.revive(event["shard"])
            case "lost":
                nodes = [topology.ids[k] for k in self._shards[event["shard"]]]
                run.change(with_loss(topology, event["shard"], nodes, step))
                self._say(run, f"step {step}: going on without {event['who']}: {event['cause']}", "WARN", step)
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

    def _warn(self, run: Run) -> None:
        """Say what is wrong with the viewer."""
        while run.warnings:
            self._screen.say(run.warnings.popleft())

    def _say(self, run: Run, text: str, level: str, step: int) -> None:
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

    def _nobody_comes(self) -> bool:
        """Whether those who are started elsewhere are not there, and will not be."""
        over = self._meeting is not None and self._meeting.is_over(self._ending.first_step_s is not None)
        if over and self._meeting is not None:
            self._ending.stopped = self._ending.stopped or self._meeting.reason
        return over

    def _explain(self, run: Run, dead: list[Dead]) -> None:
        """Why the run ended before its last step, if it did."""
        done = run.observer.end.t if run.observer.end is not None else run.observer.next_step
        if dead:
            self._folder.event("processes_died", processes=[str(one) for one in dead])
        if done < self._topology.steps:
            reason = self._ending.stopped or (cause(dead) if dead else "stopped on request")
            self._ending.stopped = f"stopped at step {done}: {reason}"
