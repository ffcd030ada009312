"""A network with agents on the machines of a Ray cluster.

Ray chooses a machine for each agent, restarts it when it dies, and brings its log here. For the run it is a separate
agent (launch/external_agents.py), with its config as an argument. Agents and plant exchange messages over Zenoh.

A machine of the cluster loads this module and needs only the packages of an agent: other imports are late.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hedgerow.orchestrator.launch.restarts import UNREACHED_S, Restarts
from hedgerow.topologies.errors import Code, HedgerowError, UserError
from hedgerow.wire.config import Config

if TYPE_CHECKING:
    from hedgerow.orchestrator.ground.assignment import Layout
    from hedgerow.orchestrator.launch.external_agents import External
    from hedgerow.orchestrator.launch.ray_cluster import RayCluster
    from hedgerow.orchestrator.runs.folder import RunFolder
    from hedgerow.topologies.schema import Topology
    from hedgerow.wire.credentials import Credentials

ALWAYS = -1
"""Ray restarts an agent each time that it dies: `Restarts` decides when it stays down."""
READY = "ready: "
"""the start of the log line of an agent that has reached the router and has its place"""
MOST_PER_CPU = 20
"""Each is a whole Python process, with all of Ray in it."""
WAIT_S = 120.0
"""The default time to place the agents and to wait for them [s]."""
SOONER = 0.8
"""The agents give up before we do, with the reason."""
LOOK_EVERY_S = 0.5
END_DEADLINE_S = 2.0
"""The time for agents to leave by themselves and to log their last lines, after the end of the plant [s]."""


class RemoteAgent:
    """One agent in a Ray worker on some machine, with two threads: one runs the agent, one reports on it."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def run(self, config: Config, wait_s: float, credentials: Credentials | None) -> str:
        """Run the agent until the plant sends END; return the reason for a failure, or an empty text."""
        from hedgerow.agents.standalone import take_part  # noqa: PLC0415
        from hedgerow.wire.child import Line  # noqa: PLC0415
        from hedgerow.wire.runtime import share_the_cores  # noqa: PLC0415

        listener = _Lines(self._lines)
        listener.setFormatter(Line())
        logging.getLogger().addHandler(listener)
        logging.getLogger("agent").setLevel(logging.INFO)
        share_the_cores()
        try:
            take_part(config, config.router, self._patience(wait_s), credentials)
        except HedgerowError as error:
            return str(error)
        except Exception as error:
            logging.exception("unexpected")
            return f"{type(error).__name__}: {error}"
        return ""

    @staticmethod
    def _patience(wait_s: float) -> float:
        """Return the time that this life waits for the router [s]: after a restart, as long as `up` restarts its own
        agents.
        """
        import ray  # noqa: PLC0415

        restarted = ray.get_runtime_context().was_current_actor_reconstructed
        return max(wait_s, UNREACHED_S) if restarted else wait_s

    def look(self, seen: int) -> tuple[str, int, list[str]]:
        """Return the machine's address, the process id, and the log lines after the first `seen`."""
        import ray  # noqa: PLC0415

        return ray.util.get_node_ip_address(), os.getpid(), self._lines[seen:]


class _Lines(logging.Handler):
    def __init__(self, lines: list[str]) -> None:
        super().__init__(logging.INFO)
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append(self.format(record))


@dataclass
class _Placed:
    """The state of one agent, as known here."""

    name: str
    actor: Any
    running: Any
    """the future result of its `run`"""
    looking: Any = None
    """the future result of its `look`"""
    pid: int = 0
    where: str = ""
    seen: int = 0
    """the number of log lines received"""
    reached: bool = False
    """this life has reached the router"""
    restarts: Restarts = field(default_factory=Restarts)
    over: bool = False
    """its `run` has returned"""
    last: bool = False
    """it had ended before the last request: after that answer its log is complete"""
    known: bool = False
    """that answer has arrived"""


@dataclass
class Fleet:
    """All agents of a run on a cluster."""

    on: OnRay
    folder: RunFolder
    on_change: Callable[[], None]
    say: Callable[[str], None]
    restarts: int = 0
    down: list[str] = field(default_factory=list)
    """the agents that stay down, with the reason"""

    @property
    def _ray(self) -> Any:
        return self.on.cluster.ray

    @property
    def reason(self) -> str:
        """Return the reason to stop waiting: the failure of an agent to start; otherwise an empty text."""
        return self.down[0] if self.down else ""

    @contextlib.contextmanager
    def placed(self, known: Sequence[tuple[Config, Credentials | None]], wait_s: float) -> Iterator[None]:
        """Run agents with these configs, and with credentials in a secure network, while the block lasts."""
        actors = self._ray.remote(RemoteAgent).options(
            num_cpus=self.on.share,
            scheduling_strategy="SPREAD",
            max_restarts=ALWAYS,
            max_task_retries=ALWAYS,
            max_concurrency=2,
        )
        agents = []
        over = threading.Event()
        try:
            for config, own in known:
                actor = actors.remote()
                agents.append(_Placed(config.process, actor, actor.run.remote(config, SOONER * wait_s, own)))
            watcher = threading.Thread(target=self._watch, args=(agents, over), name="ray", daemon=True)
            watcher.start()
            try:
                yield
            finally:
                over.set()
                watcher.join(2 * END_DEADLINE_S)
        finally:
            for agent in agents:
                with contextlib.suppress(Exception):  # errors of a cluster that is gone itself
                    self._ray.kill(agent.actor)

    def _watch(self, agents: Sequence[_Placed], over: threading.Event) -> None:
        try:
            self._tend(agents, over)
        except Exception as error:  # the run does not need Ray any more, unless an agent dies
            why = (str(error).strip() or type(error).__name__).splitlines()[0]
            self.say(f"--on {self.on.cluster.address}: out of reach: {why}; the logs of agents end here")

    def _tend(self, agents: Sequence[_Placed], over: threading.Event) -> None:
        """Collect logs and detect deaths, until `over` and then until all agents have left or should have."""
        everybody = False
        while not over.wait(LOOK_EVERY_S):
            self._look(agents)
            if not everybody and all(agent.pid for agent in agents):
                everybody = True
                self.say(f"Ray has placed {_where(agents)}")
        by = time.monotonic() + END_DEADLINE_S
        self._ray.wait([agent.running for agent in agents], num_returns=len(agents), timeout=END_DEADLINE_S)
        while time.monotonic() < by and not all(agent.known for agent in agents):
            self._look(agents)

    def _look(self, agents: Sequence[_Placed]) -> None:
        ray = self._ray
        for agent in agents:
            if agent.looking is None and not agent.known:
                agent.last = agent.over
                agent.looking = agent.actor.look.options(max_task_retries=0).remote(agent.seen)
        waiting = [ref for one in agents for ref in (one.looking, None if one.over else one.running) if ref is not None]
        if not waiting:
            return
        ready, _ = ray.wait(waiting, num_returns=len(waiting), timeout=LOOK_EVERY_S)
        for agent in agents:
            if agent.looking in ready:
                with contextlib.suppress(ray.exceptions.RayError):  # it died, or it is not there yet
                    self._take(agent, *ray.get(agent.looking))
                agent.looking, agent.known = None, agent.last
            if agent.running in ready and not agent.over:
                agent.over = True
                try:
                    why = ray.get(agent.running)
                except ray.exceptions.RayError as error:
                    why = f"died, and Ray starts it no more: {str(error).strip().splitlines()[0]}"
                if why:
                    self.down.append(f"{agent.name}: {why}")
                    self.on_change()

    def _take(self, agent: _Placed, where: str, pid: int, lines: Sequence[str]) -> None:
        if (where, pid) != (agent.where, agent.pid):
            again = agent.pid != 0
            self.restarts += again
            happened = "restarted" if again else "placed"
            self.folder.event(happened, process=agent.name, machine=where, pid=pid)
            # The counted log lines belong to its earlier life.
            lines = [f"-- {'again ' if again else ''}on {where}, process {pid}", *([] if again else lines)]
            if again and agent.restarts.after_death(agent.reached, time.monotonic()) is None:
                self._ray.kill(agent.actor)  # its `run` then ends, and the agent is down
            agent.where, agent.pid, agent.seen, agent.reached = where, pid, -1, False
        agent.seen += len(lines)
        agent.reached = agent.reached or any(READY in line for line in lines)
        if lines:
            with contextlib.suppress(OSError), (self.folder.logs / f"{agent.name}.log").open("a") as log:
                log.writelines(f"{line}\n" for line in lines)


def share_of(agents: int, free: float, machines: int) -> float:
    """Return the CPUs that each agent requests from Ray: one if there are enough, otherwise a part of one such that all
    fit.
    """
    if agents <= free:
        return 1.0
    # The unused rest of a machine is less than one share.
    share = int(1e4 * free / (agents + machines)) / 1e4
    if share * MOST_PER_CPU < 1:
        most = int(free * MOST_PER_CPU) - machines
        raise UserError(
            f"--on ray: {agents} agent process{'es' * (agents != 1)} do not fit a cluster with {free:g} free CPUs"
            f" on {machines} machine{'s' * (machines != 1)}, at most {MOST_PER_CPU} per CPU. Add machines, end other"
            " programs there" + (f", or put several nodes in a process, --processes {most}" if most > 0 else ""),
            code=Code.OPTION,
        )
    return share


def _where(agents: Sequence[_Placed]) -> str:
    """Return the machines of the agents, in words."""
    machines = dict.fromkeys(agent.where for agent in agents)
    names = {where: [agent.name for agent in agents if agent.where == where] for where in machines}
    return "; ".join(
        f"{', '.join(some[:8])}{f' and {len(some) - 8} more' if len(some) > 8 else ''} on {where}"
        for where, some in names.items()
    )


@dataclass(frozen=True)
class OnRay:
    """The agents of a network on a cluster, before they start."""

    cluster: RayCluster
    external: External
    endpoint: str
    """their endpoint to reach the run"""
    share: float
    """the CPUs that each agent requests"""


@contextlib.contextmanager
def chosen(
    on: str,
    topology: Topology,
    shards: Layout,
    router: str | None,
    listen: str | None,
    namespace: str | None,
    wait_s: float | None,
) -> Iterator[OnRay]:
    """Provide the agents for `--on ON` while we are joined to that cluster; raise UserError if it is impossible."""
    from hedgerow.orchestrator.launch import endpoints, external_agents  # noqa: PLC0415
    from hedgerow.orchestrator.launch.ray_cluster import joined  # noqa: PLC0415
    from hedgerow.wire.ports import LOOPBACK, free_port  # noqa: PLC0415

    with joined(on) as cluster:
        # Listen on loopback only if the cluster is this machine alone.
        here = LOOPBACK if cluster.machines <= {cluster.here} else cluster.here
        listens = None if router else listen or f"{'tls' if topology.secure else 'tcp'}/{here}:{free_port(here)}"
        meet = namespace or endpoints.namespace_of(topology.name)
        share = share_of(len(shards), cluster.free_cpus, len(cluster.machines))
        everybody = external_agents.chosen("all", topology, shards, router, listens, meet, wait_s or WAIT_S)
        yield OnRay(cluster, everybody, router or external_agents.local(listens or "", here), share)
