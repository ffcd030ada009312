"""The start of a run over Zenoh: the processes, the observer's session, and the processes that start separately."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import zenoh

from hedgerow.agents.law_source import source_digest
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import Layout, places, truth_of, views_of
from hedgerow.orchestrator.ground.signals import Interrupts
from hedgerow.orchestrator.launch.certificates import host_of
from hedgerow.orchestrator.launch.endpoints import Connection, wire
from hedgerow.orchestrator.launch.external_agents import Meeting, configs
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.options import Options
from hedgerow.orchestrator.launch.ray_agents import Fleet
from hedgerow.orchestrator.launch.supervisor import Processes, cause
from hedgerow.orchestrator.runs import registry
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.views.screen import Screen
from hedgerow.topologies.errors import Code, Exit, HedgerowError
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.codec import telemetry_bytes
from hedgerow.wire.credentials import Credentials
from hedgerow.wire.handshake import room
from hedgerow.wire.limits import need, need_threads
from hedgerow.wire.runtime import LONG_BYTES
from hedgerow.wire.session import CONNECT_TIMEOUT_S, RefusedError, WireError, close, open_client
from hedgerow.wire.shared_rows import SharedRows, create
from hedgerow.wire.shared_rows import close as close_shared
from hedgerow.wire.shared_steps import create_steps, worth_sharing
from hedgerow.wire.stream import rows_ahead

ROUTER_FILES = 24
"""Open files of a plant that is the router, besides one per agent process."""
AGENT_THREADS, PLANT_THREADS, OWN_THREADS = 5, 10, 9
"""Threads of a process with a Zenoh session (measured), and those that this process starts for its own."""
MOST_MEMORIES = 64
"""The maximum number of shards with memory for their states and inputs; each takes an open file."""
LOOK_S = 1.0
"""The time of one try to open our own session [s]; then we check that there is still a router to wait for."""


@dataclass(frozen=True)
class Launched:
    """The running parts of a run."""

    processes: Processes
    session: zenoh.Session
    """our own session"""
    meeting: Meeting | None
    """the meeting with processes that start elsewhere"""
    fleet: Fleet | None
    """the processes that Ray started"""
    shared: SharedRows | None
    """the memory with the telemetry of a large network"""


class Launch:
    """The processes of one run before they are started, and the place where they meet."""

    def __init__(
        self,
        topology: Topology,
        folder: RunFolder,
        shards: Layout,
        options: Options,
        screen: Screen,
        fork_client: ForkClient,
        wake: Callable[[], None],
    ) -> None:
        """`wake` is called when a process ends."""
        self._topology, self._folder, self._shards, self._options = topology, folder, shards, options
        self._screen, self._fork_client, self._wake = screen, fork_client, wake
        self.views = views_of(topology, shards, source_digest(topology.law))
        """the local view of every agent process"""
        self.connection = self._wire()
        """the router's endpoint, the namespace and the credentials"""

    def _wire(self) -> Connection:
        secure, options = self._topology.secure, self._options
        if options.external is None:
            return wire(self._folder, secure, options.router, options.keys, places(self.views))
        connection = options.external.connection(options.router, options.keys)
        if secure and options.keys is None and options.ray is not None:
            return connection.with_keys_of_its_own(self._folder, host_of(options.ray.endpoint))
        return connection

    def announced(self) -> contextlib.AbstractContextManager[Path]:
        """List the run in the registry while the block lasts."""
        self._fork_client.on_end = self._wake
        # Register the files before they exist: if this process is killed, none of them remains.
        self._fork_client.leave_no([registry.entry_path(self._folder.name), *self.connection.traces])
        connection = self.connection
        return registry.announced(
            self._folder.name,
            self._folder.path,
            connection.endpoint,
            connection.namespace,
            connection.credentials,
            connection.traces,
        )

    def start(
        self, stack: contextlib.ExitStack, interrupts: Interrupts, meanwhile: Callable[[], object] = lambda: None
    ) -> Launched:
        """Start the processes and open our own session; closing `stack` undoes each.

        `meanwhile` is called while the processes start. If agents come from elsewhere, it is called before: when one of
        an earlier run reached the router before our session, Zenoh sometimes gave us each batch of telemetry twice.
        """
        connection = self.connection
        if self._options.external is not None:
            meanwhile()
        stack.enter_context(connection.laid(places(self.views)))
        stack.callback(self._fork_client.clear)
        external = self._options.external
        ours = [view for view in self.views if external is None or view.shard not in external]
        is_plant_ours = external is None or not external.plant
        memories = self._memories(ours, stack) if is_plant_ours else {}
        processes = Processes(self._fork_client, self._folder, connection, memories)
        if connection.listens:  # without this, agents that the router cannot accept would be restarted for a minute
            need(f"a plant with {len(self.views)} agent processes", open_files=len(self.views) + ROUTER_FILES)
        meeting, fleet = None, None
        need_threads("this run", AGENT_THREADS * len(ours) + PLANT_THREADS + OWN_THREADS)
        shared: SharedRows | None = None
        # Start no process if there is no router.
        session = None if connection.listens else self._connect(processes, interrupts, stack)
        if is_plant_ours:
            if session is not None:  # nor if another network runs there
                stack.enter_context(room(session, connection.namespace, self._screen.say, lambda: interrupts.count > 0))
                if interrupts.count:
                    raise HedgerowError(interrupts.name)
            truth = truth_of(self._topology, self._shards)
            shared, path = self._shared(stack)
            processes.start_plant(truth, self._options.rate, self._options.deadline_s, external, path)
        processes.start_agents(ours)
        if external is None:
            meanwhile()
        session = session or self._connect(processes, interrupts, stack)
        pids = processes.wait_until_started()
        if external is not None:
            self._screen.say(
                f"waiting for {external} at {external.listen or connection.endpoint}, {connection.namespace}"
            )
            meeting = Meeting(external, session, self._folder.logs / f"{keys.PLANT}.log")
            stack.enter_context(meeting.watched())
            if external.plant:
                meeting.introduce()
        if external is not None and self._options.ray is not None:
            elsewhere = configs(self._topology, self._shards, self._options.ray.endpoint, connection.namespace)
            fleet = Fleet(self._options.ray, self._folder, self._wake, self._screen.say)
            own = [Credentials.read(where) if (where := connection.of(one.process)) else None for one in elsewhere[1:]]
            stack.enter_context(fleet.placed([*zip(elsewhere[1:], own, strict=True)], external.wait_s))
        self._folder.event(
            "start", engine="zenoh", endpoint=connection.endpoint, namespace=connection.namespace, pids=pids
        )
        return Launched(processes, session, meeting, fleet, shared)

    def _shared(self, stack: contextlib.ExitStack) -> tuple[SharedRows | None, str]:
        """Return memory for the telemetry of a large network, and its path, while `stack` lasts."""
        n, e = len(self._topology.ids), len(self._topology.edges)
        if telemetry_bytes(n, e) <= LONG_BYTES:
            return None, ""
        shared, path = create(telemetry_bytes(n, e), rows_ahead(n, e))
        stack.callback(close_shared, path)
        return shared, path

    def _memories(self, ours: Sequence[View], stack: contextlib.ExitStack) -> Mapping[int, str]:
        """Return the paths of memory for the states and inputs of our own large shards, while `stack` lasts."""
        memories = {}
        for view in ours[:MOST_MEMORIES]:
            k, m = view.k, len(view.row)
            if worth_sharing(k, m) and (path := create_steps(k, m)):
                stack.callback(close_shared, path)
                memories[view.shard] = path
        return memories

    def _connect(self, processes: Processes, interrupts: Interrupts, stack: contextlib.ExitStack) -> zenoh.Session:
        """Return our own session while `stack` lasts; raise HedgerowError if no router comes in time, or our router
        died.
        """
        connection, external = self.connection, self._options.external
        wait_s = external.wait_s if external and external.plant else CONNECT_TIMEOUT_S
        by = time.monotonic() + wait_s
        # Read them once, to report a problem only once.
        own = Credentials.read(connection.own) if connection.own else None
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
