"""The processes of a run: started with their data, watched, and ended with this process."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import process_name
from hedgerow.orchestrator.ground.law_source import kept_path
from hedgerow.orchestrator.launch.endpoints import Connection
from hedgerow.orchestrator.launch.external_agents import OWN_START_S, External
from hedgerow.orchestrator.launch.fork_client import ForkClient, Order
from hedgerow.orchestrator.launch.restarts import Restarts
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.plant.truth import Truth
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.regular_file import last_text
from hedgerow.wire import keys
from hedgerow.wire.child import ERROR_PREFIX, SLOW_LAW, USER_ERROR

SMALL = 64
"""the most nodes of a shard with its local view in a JSON file"""


@dataclass(frozen=True)
class Dead:
    """A process that ended: its name, its exit, the error at the end of its log (empty if there is none), and its
    log.
    """

    name: str
    code: int
    error: str
    log: Path

    def __str__(self) -> str:
        how = f"was killed by {signal.Signals(-self.code).name}" if self.code < 0 else f"ended with code {self.code}"
        # The fork server has no log, and names the file itself.
        traced = f"; the traceback is in {self.log}" if self.code == Exit.CRASH and self.log.exists() else ""
        return f"{self.name} {how}" + (f": {self.error}" if self.error else "") + traced


def cause(dead: Sequence[Dead]) -> str:
    """Return the message about processes that died."""
    ending = ", …" if len(dead) > 8 else ""
    others = f" (and {len(dead) - 1} more: {', '.join(one.name for one in dead[1:8])}{ending})" if len(dead) > 1 else ""
    return f"{dead[0]}{others}"


@dataclass
class _Agent:
    """One agent process over all its lives."""

    shard: int
    file: Path
    """its local view"""
    life: int = 0
    alive: bool = True
    starting: bool = False
    """it was restarted, and its process id is unknown yet"""
    killed: bool = False
    """we ended this life, or are about to do so"""
    reported: bool = False
    """the plant knows that this life ended"""
    again: bool = False
    """another life will follow"""
    due: float = 0.0
    """not before this time, by time.monotonic()"""
    restarts: Restarts = field(default_factory=Restarts)
    dead: Dead | None = None
    """the last unplanned death"""
    undecided: bool = False
    """this death is unplanned, and the plant has not answered whether that life had reached the router"""


class Processes:
    """The plant and the agents of one run, each a separate process with a log."""

    def __init__(
        self,
        fork_client: ForkClient,
        folder: RunFolder,
        connection: Connection,
        memories: Mapping[int, str] | None = None,
    ) -> None:
        """`memories` are the paths of memory that the plant shares with shards; see `wire.shared_steps`."""
        self._fork_client, self._folder = fork_client, folder
        self._connection, self._memories = connection, memories or {}
        self._connect = ["--connect", connection.endpoint]
        self._names: list[str] = []
        self._agents: dict[str, _Agent] = {}
        self.deaths: dict[int, int] = {}
        """by shard: the number of abnormal ends of its process"""
        self.restarts = 0
        self.down: list[Dead] = []
        """the agents that stay down"""

    def start_agents(self, views: Iterable[View]) -> None:
        """Launch shards, each with its local view alone."""
        orders = []
        for view in views:
            name = process_name(view)
            self.deaths[view.shard] = 0
            # A process takes 8 ms to read its first .npz file, and 0.1 ms to read JSON.
            file = self._folder.processes / f"{name}.{'json' if view.k <= SMALL else 'npz'}"
            view.write(file)
            self._agents[name] = agent = _Agent(view.shard, file)
            orders.append(self._order_of(name, agent))
            self._names.append(name)
        self._fork_client.fork(*orders)

    def start_plant(
        self, truth: Truth, rate: float, deadline_s: float, external: External | None = None, shared: str = ""
    ) -> None:
        """Launch the plant, which is the router unless there is one, with a port for `external` processes.

        `shared` is the path of memory for its telemetry; see `wire.shared_rows`.
        """
        options = ["--rate", str(rate), "--deadline", str(deadline_s), *(["--shared", shared] if shared else [])]
        options += [word for p, path in self._memories.items() for word in ("--memory", str(p), path)]
        if external is not None:
            options += ["--network", external.network, "--start", str(external.wait_s + OWN_START_S)]
        listen = external.listen if external and external.listen else self._connection.endpoint
        options += ["--listen", listen] if self._connection.listens else self._connect
        file = self._folder.processes / f"{keys.PLANT}.npz"
        truth.write(file)
        self._fork_client.fork(self._order(keys.PLANT, "plant", file, options))
        self._names.append(keys.PLANT)

    def _order_of(self, name: str, agent: _Agent) -> Order:
        """Return the order of the next life of an agent."""
        options = [*self._connect, "--life", str(agent.life)]
        if (memory := self._memories.get(agent.shard)) is not None:
            options += ["--memory", memory]
        return self._order(name, "agents", agent.file, options)

    def _order(self, name: str, module: str, file: Path, options: Sequence[str]) -> Order:
        arguments = [str(file), "--namespace", self._connection.namespace, *options]
        if module == "agents" and (path := kept_path()) is not None:
            arguments += ["--law-path", str(path)]  # the fork server began before the path of modules changed
        credentials = self._connection.of(name)
        if credentials is not None:
            arguments += ["--credentials", str(credentials)]
        return Order(name, module, arguments, self._log(name))

    def wait_until_started(self) -> dict[str, int]:
        """Wait until all processes run; return the process ids by name."""
        self._fork_client.wait_until_forked(self._names)
        return dict(self._fork_client.pids)

    def kill(self, shard: int, life: int, restart: bool) -> None:
        """Kill the agent process of a shard, for a crash fault of the plant; restart it if the fault ends."""
        name, agent = self._agent(shard)
        if agent.life == life:
            agent.killed, agent.again, agent.undecided = True, restart, False
            self._fork_client.kill(name)

    def revive(self, shard: int) -> None:
        """Restart the agent process of a shard that was meant to stay down."""
        _, agent = self._agent(shard)
        agent.again = agent.again or agent.killed

    def _agent(self, shard: int) -> tuple[str, _Agent]:
        return next((name, agent) for name, agent in self._agents.items() if agent.shard == shard)

    def tend(self, tell_died: Callable[[int, int], bool | None]) -> list[dict[str, Any]]:
        """Detect deaths, and restart the agents that are due; return the new events.

        `tell_died(shard, life)` reports to the plant. It returns True if that life had reached the router, and False if
        not. It returns None if the plant did not answer; then it is called again.
        """
        happened: list[dict[str, Any]] = []
        for name, agent in self._agents.items():
            if agent.starting and (pid := self._fork_client.pids.get(name)) is not None:
                agent.starting = False
                happened.append({"kind": "restarted", "process": name, "pid": pid, "life": agent.life})
            code = self._fork_client.codes.get(name)
            if agent.alive and code not in (None, 0, USER_ERROR):
                agent.alive, agent.reported = False, False
                self.deaths[agent.shard] += 1
                if not agent.killed:
                    agent.dead, agent.undecided = Dead(name, code, self._last_error(name), self._log(name)), True
                    happened.append({"kind": "died", "process": name, "how": str(agent.dead), "code": code})
            if not agent.alive and not agent.reported and (reached := tell_died(agent.shard, agent.life)) is not None:
                agent.reported = True
                if agent.undecided and agent.dead is not None and not self._restarts(agent, reached):
                    self.down.append(agent.dead)
                    happened.append({"kind": "down", "process": name, "how": str(agent.dead)})
            if agent.reported and agent.again and time.monotonic() >= agent.due:
                agent.life += 1
                agent.alive = agent.starting = True
                agent.killed = agent.reported = agent.again = False
                self.restarts += 1
                self._fork_client.fork(self._order_of(name, agent))
        return happened

    @staticmethod
    def _restarts(agent: _Agent, reached: bool) -> bool:
        """Decide after an unplanned death if and when another life follows; return True if one does."""
        now, agent.undecided = time.monotonic(), False
        pause = agent.restarts.after_death(reached, now)
        agent.again, agent.due = pause is not None, now + (pause or 0.0)
        return agent.again

    @property
    def failing(self) -> list[Dead]:
        """Return the agents that died more than RESTARTS times, in any way; before the first step they end the run."""
        return [agent.dead for agent in self._agents.values() if agent.dead and agent.restarts.failed]

    @property
    def next_due(self) -> float | None:
        """Return the latest time of the next call of `tend`, by time.monotonic(); None if there is none."""
        return min((agent.due for agent in self._agents.values() if agent.reported and agent.again), default=None)

    def dead(self) -> list[Dead]:
        """Return the processes with an abnormal end that ends the run: the plant, or an agent after a mistake of the
        user.
        """
        return [
            Dead(name, code, self._last_error(name) or self._fork_server_error(name), self._log(name))
            for name, code in dict(self._fork_client.codes).items()
            if code and (name not in self._agents or code == USER_ERROR)
        ]

    def slow_law(self, step: int, shard: int | None = None) -> str:
        """Return the line of the law that an agent is busy with at a step, from its log; empty if there is none."""
        for name, agent in self._agents.items():
            if shard is not None and agent.shard != shard:
                continue
            found = self._last_line(name, lambda line: SLOW_LAW in line and f"step {step}: law " in line)
            if found:
                return f"{name}: {found[found.index('law ') :]}"
        return ""

    def ended(self, name: str) -> bool:
        """Return True if that process has ended, normally or not."""
        return name in self._fork_client.codes or "fork server" in self._fork_client.codes

    def wait(self, plant_s: float, agents_s: float) -> None:
        """Wait up to `plant_s` for the plant to end by itself, and then up to `agents_s` for the agents."""
        self._fork_client.wait([keys.PLANT], plant_s)
        self._fork_client.wait(list(self._agents), agents_s)

    def _fork_server_error(self, name: str) -> str:
        return self._fork_client.error if name == "fork server" else ""

    def _log(self, name: str) -> Path:
        return self._folder.logs / f"{name}.log"

    def _last_error(self, name: str) -> str:
        return self._last_line(name, lambda line: line.startswith(ERROR_PREFIX)).removeprefix(ERROR_PREFIX)

    def _last_line(self, name: str, wanted: Callable[[str], bool]) -> str:
        """Return the last matching line of a log; empty if there is none."""
        try:
            lines = last_text(self._log(name)).splitlines()
        except OSError:
            return ""
        return next((line for line in reversed(lines) if wanted(line)), "")
