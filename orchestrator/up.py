"""A run over Zenoh: one plant, agent processes, a router between them, and the observer here."""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import zenoh

from orchestrator import registry
from orchestrator.assign import Layout, truth_of, views_of
from orchestrator.control import ask
from orchestrator.folder import RunFolder
from orchestrator.interrupts import Interrupts
from orchestrator.nursery import Nursery
from orchestrator.run import Run, Watching
from orchestrator.screen import Screen
from orchestrator.simulate import equals_reference
from orchestrator.supervise import Dead, Processes, cause, socket_path
from orchestrator.verdict import Ending, Verdict
from orchestrator.viewer import Viewer
from topologies.errors import HedgerowError
from topologies.schema import Topology
from wire import keys
from wire.codec import Kind, decode_end, decode_telemetry, encode_seen, kind_of
from wire.session import WireError, open_client, open_router, publisher, remove_socket, subscriber

TICK_S = 0.2
"""How often telemetry is taken in: in batches, off the loop's path."""
WAKE_ROWS = 512
END_DEADLINE_S = 5.0
"""How long processes have to end by themselves once told."""


@dataclass(frozen=True)
class Options:
    """How a network is run; nothing here changes its trajectory."""

    rate: float = 0.0
    """steps per second, 0 for as fast as possible"""
    deadline_s: float = 10.0
    """how long the plant waits for an input before it gives up"""
    router: str | None = None
    """an existing router's endpoint; None for one of our own"""
    watching: Watching = field(default_factory=Watching)
    verify: bool = False
    """compare with the in-process reference afterwards"""


class _Inbox:
    """Telemetry between Zenoh's thread and ours."""

    def __init__(self) -> None:
        self._messages: deque[bytes] = deque()
        self.first_at: float | None = None
        self.wake = threading.Event()
        """something should be looked at before the next tick"""

    def put(self, message: bytes) -> None:
        self._messages.append(message)
        if self.first_at is None and kind_of(message) == Kind.TELEMETRY:
            self.first_at = time.monotonic()
            self.wake.set()
        elif len(self._messages) >= WAKE_ROWS or kind_of(message) == Kind.END:
            self.wake.set()

    def drain(self) -> list[bytes]:
        return [self._messages.popleft() for _ in range(len(self._messages))]


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
        self._inbox = _Inbox()
        self._namespace = f"hedgerow/{folder.name}-{secrets.token_hex(4)}"
        self._socket = socket_path(folder) if options.router is None else None
        self._endpoint = options.router or f"unixsock-stream/{self._socket}"
        self._asked_at: float | None = None
        """when the plant was first asked to stop"""
        self._answered = False

    def run(self, on_first_step: Callable[[float], None] = lambda _: None) -> Verdict:
        """Launch, observe until the end or an interrupt, clean up, and judge.

        `on_first_step` is called with the seconds from the command to the first step, once it is done.
        """
        dead: list[Dead] = []
        with Interrupts(self._inbox.wake.set) as interrupts, self._announced() as listed:
            run = Run(self._topology, self._folder, self._options.watching, self._ending)
            try:
                with contextlib.ExitStack() as stack:
                    processes, session = self._launch(stack, listed)
                    try:
                        self._observe(run, session, processes, interrupts, on_first_step)
                        processes.wait(END_DEADLINE_S)
                    finally:
                        dead = processes.dead()
            except (HedgerowError, OSError) as error:
                self._ending.stopped = str(error)
            self._explain(run, dead)
            if self._options.verify and not self._ending.stopped:
                run.close_tables()
                self._ending.reference_equal = equals_reference(self._topology, self._folder)
            verdict = run.close()
            self._screen.verdict(verdict, self._folder.path)
            if run.viewer is not None:
                self._serve(run.viewer, interrupts)
        return verdict

    def _serve(self, viewer: Viewer, interrupts: Interrupts) -> None:
        """Keep a web page up until Ctrl-C, where somebody can press that."""
        if viewer.link is not None and self._screen.interactive and not interrupts.count:
            self._screen.say(f"{viewer.link} stays until Ctrl-C")
            self._inbox.wake.clear()
            while not interrupts.count:
                self._inbox.wake.wait(TICK_S)
        viewer.end()

    def _announced(self) -> contextlib.AbstractContextManager[Path]:
        return registry.announced(self._folder.name, self._folder.path, self._endpoint, self._namespace)

    def _launch(self, stack: contextlib.ExitStack, listed: Path) -> tuple[Processes, zenoh.Session]:
        """Router, processes, our own session; each is undone when `stack` closes, however that comes."""
        if self._socket is not None:
            stack.callback(_remove_socket, self._socket, self._folder)
            stack.enter_context(open_router(self._endpoint))
        stack.callback(self._nursery.close)
        processes = Processes(self._nursery, self._folder, self._namespace, self._endpoint)
        truth = truth_of(self._topology, self._shards)
        processes.start_plant(truth, self._options.rate, self._options.deadline_s, self._socket, listed)
        for view in views_of(self._topology, self._shards):
            processes.start_agent(view)
        session = stack.enter_context(open_client(self._endpoint, self._namespace))
        pids = processes.wait_until_started()
        self._folder.event("start", engine="zenoh", endpoint=self._endpoint, namespace=self._namespace, pids=pids)
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
        with subscriber(session, keys.TELEMETRY, self._inbox.put):
            seen = publisher(session, keys.SEEN)
            while run.observer.end is None:
                self._inbox.wake.wait(TICK_S)
                self._inbox.wake.clear()
                if self._ending.first_step_s is None and self._inbox.first_at is not None:
                    self._ending.first_step_s = self._inbox.first_at - self._began
                    self._folder.event("first_step", after_s=round(self._ending.first_step_s, 3))
                    on_first_step(self._ending.first_step_s)
                nobody_left = processes.ended(keys.PLANT) or self._asked_long_ago()
                if self._take_in(run):
                    seen.put(encode_seen(run.observer.next_step - 1))
                elif nobody_left:
                    return
                if interrupts.count or processes.dead():
                    self._ask_to_stop(session, interrupts.name)

    def _take_in(self, run: Run) -> bool:
        """Observe what has come; whether anything had."""
        messages = self._inbox.drain()
        n, e = len(self._topology.ids), len(self._topology.edges)
        rows = [decode_telemetry(message, n, e) for message in messages if kind_of(message) == Kind.TELEMETRY]
        if rows:
            unseen = run.viewer is None
            self._screen.progress(run.take(rows))
            if unseen and run.viewer is not None:
                self._screen.say(f"watch it at {run.viewer.link or run.viewer.url}")
        if messages and kind_of(messages[-1]) == Kind.END:
            run.finish(decode_end(messages[-1], n))
        return bool(messages)

    def _ask_to_stop(self, session: zenoh.Session, why: str) -> None:
        """Ask the plant to end the run, again at every tick until it answers: it may not have begun yet."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()
            self._ending.stopped = why
            self._folder.event("stopping", why=why or "a process died")
        if not self._answered:
            with contextlib.suppress(WireError):
                ask(session, keys.STOP, timeout_s=1.0)
                self._answered = True

    def _asked_long_ago(self) -> bool:
        return self._asked_at is not None and time.monotonic() - self._asked_at > END_DEADLINE_S

    def _explain(self, run: Run, dead: list[Dead]) -> None:
        """Why the run ended before its last step, if it did."""
        done = run.observer.end.t if run.observer.end is not None else run.observer.next_step
        if dead:
            self._folder.event("processes_died", processes=[str(one) for one in dead])
        if done < self._topology.steps:
            reason = self._ending.stopped or (cause(dead) if dead else "stopped on request")
            self._ending.stopped = f"stopped at step {done}: {reason}"


def _remove_socket(socket: Path, folder: RunFolder) -> None:
    remove_socket(socket)
    if socket != folder.socket:
        socket.parent.rmdir()
