"""A run over Zenoh: one plant, agent processes, a router between them, and the observer here."""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zenoh

from orchestrator import registry
from orchestrator.assign import Layout, truth_of, views_of
from orchestrator.control import ask
from orchestrator.folder import RunFolder
from orchestrator.interrupts import EndNowError, Interrupts
from orchestrator.run import Run, Watching
from orchestrator.screen import Screen
from orchestrator.simulate import equals_reference
from orchestrator.supervise import Dead, Processes, cause, socket_path
from orchestrator.verdict import Ending, Verdict
from topologies.errors import UserError
from topologies.schema import Topology
from wire import keys
from wire.codec import Kind, decode_end, decode_telemetry, encode_seen, kind_of
from wire.session import WireError, open_client, open_router, publisher, subscriber

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
    watching: Watching = Watching()
    verify: bool = False
    """compare with the in-process reference afterwards"""


class _Inbox:
    """Telemetry between Zenoh's thread and ours."""

    def __init__(self) -> None:
        self._messages: deque[bytes] = deque()
        self.first_at: float | None = None
        self.wake = threading.Event()
        """something should be looked at before the next tick"""

    def put(self, _: str, message: bytes) -> None:
        self._messages.append(message)
        if self.first_at is None:
            self.first_at = time.monotonic()
            self.wake.set()
        elif len(self._messages) >= WAKE_ROWS or kind_of(message) == Kind.END:
            self.wake.set()

    def drain(self) -> list[bytes]:
        return [self._messages.popleft() for _ in range(len(self._messages))]


class Network:
    """The processes of one run and what is heard of them, from launch to verdict."""

    def __init__(
        self, topology: Topology, folder: RunFolder, shards: Layout, options: Options, screen: Screen, began: float
    ) -> None:
        """`began` is when the command was given, by time.monotonic(): the first step is counted from there."""
        self._topology, self._folder, self._shards, self._options = topology, folder, shards, options
        self._screen, self._began = screen, began
        self._ending = Ending(run=folder.name, engine="zenoh", processes=len(shards))
        self._inbox = _Inbox()
        self._asked_at: float | None = None
        """when the plant was asked to stop"""

    def run(self, on_first_step: Callable[[], None] = lambda: None) -> Verdict:
        """Launch, observe until the end or an interrupt, clean up, and judge; UserError when a process says so."""
        with Interrupts(self._inbox.wake.set) as interrupts:
            run = Run(self._topology, self._folder, self._options.watching, self._ending)
            dead: list[Dead] = []
            try:
                with contextlib.ExitStack() as stack:
                    processes, session = self._launch(stack)
                    try:
                        self._observe(run, session, processes, interrupts, on_first_step)
                        processes.wait(END_DEADLINE_S)
                    finally:
                        dead = processes.dead()
            except (EndNowError, WireError, OSError) as error:
                self._ending.stopped = f"{error} at step {run.observer.next_step}"
            self._explain(run, dead)
            if self._options.verify and not self._ending.stopped:
                run.close_tables()
                self._ending.reference_equal = equals_reference(self._topology, self._folder)
            verdict = run.close()
        mistake = cause(dead) if dead else None
        if isinstance(mistake, UserError):
            raise mistake
        return verdict

    def _launch(self, stack: contextlib.ExitStack) -> tuple[Processes, zenoh.Session]:
        """Router, processes, our own session; each is undone when `stack` closes, however that comes."""
        namespace = f"hedgerow/{self._folder.name}-{secrets.token_hex(4)}"
        endpoint, socket = self._options.router, None
        if endpoint is None:
            socket = socket_path(self._folder)
            endpoint = f"unixsock-stream/{socket}"
            stack.callback(_remove_socket, socket, self._folder)
            stack.enter_context(open_router(endpoint))
        processes = Processes(self._folder, namespace, endpoint)
        stack.callback(processes.kill)
        processes.start_plant(truth_of(self._topology, self._shards), self._options.rate, self._options.deadline_s, socket)
        for view in views_of(self._topology, self._shards):
            processes.start_agent(view)
        session = stack.enter_context(open_client(endpoint, namespace))
        stack.enter_context(registry.announced(self._folder.name, self._folder.path, endpoint, namespace))
        self._folder.event("start", engine="zenoh", endpoint=endpoint, namespace=namespace, pids=processes.pids)
        return processes, session

    def _observe(
        self,
        run: Run,
        session: zenoh.Session,
        processes: Processes,
        interrupts: Interrupts,
        on_first_step: Callable[[], None],
    ) -> None:
        """Take telemetry in, batch by batch, until the plant's END or until there is nobody to wait for."""
        subscriber(session, keys.TELEMETRY, self._inbox.put)
        seen = publisher(session, keys.SEEN)
        while run.observer.end is None:
            self._inbox.wake.wait(TICK_S)
            self._inbox.wake.clear()
            gone = processes.ended(keys.PLANT)
            if self._take_in(run):
                seen.put(encode_seen(run.observer.next_step - 1))
                if self._ending.first_step_s is None and self._inbox.first_at is not None:
                    self._ending.first_step_s = self._inbox.first_at - self._began
                    self._folder.event("first_step", after_s=round(self._ending.first_step_s, 3))
                    on_first_step()
            elif gone or (self._asked_at is not None and time.monotonic() - self._asked_at > END_DEADLINE_S):
                return
            if self._asked_at is None and (interrupts.count or processes.dead()):
                if interrupts.count:
                    self._ending.stopped = f"stopped by {interrupts.name}"
                self._ask_to_stop(session)

    def _take_in(self, run: Run) -> bool:
        """Observe what has come; whether anything had."""
        messages = self._inbox.drain()
        n, e = len(self._topology.ids), len(self._topology.edges)
        rows = [decode_telemetry(message, n, e) for message in messages if kind_of(message) == Kind.TELEMETRY]
        if rows:
            self._screen.progress(run.take(rows))
        if messages and kind_of(messages[-1]) == Kind.END:
            run.finish(decode_end(messages[-1], n))
        return bool(messages)

    def _ask_to_stop(self, session: zenoh.Session) -> None:
        self._asked_at = time.monotonic()
        # A plant that is gone or frozen does not answer; the deadline of _observe takes care of it.
        with contextlib.suppress(WireError):
            ask(session, keys.STOP)

    def _explain(self, run: Run, dead: list[Dead]) -> None:
        """Why the run ended before its last step, if it did."""
        done = run.observer.end.t if run.observer.end is not None else run.observer.next_step
        if dead and not self._ending.stopped:
            self._ending.stopped = str(cause(dead))
            self._folder.event("processes_died", processes=[str(one) for one in dead])
        elif done < self._topology.steps and " at step " not in self._ending.stopped:
            self._ending.stopped = f"{self._ending.stopped or 'stopped on request'} at step {done}"


def _remove_socket(socket: Path, folder: RunFolder) -> None:
    socket.unlink(missing_ok=True)
    if socket != folder.socket:
        socket.parent.rmdir()
