"""A network whose agents live on the machines of a Ray cluster.

Ray finds each a machine, starts it again when it dies, and brings its log here. An agent there is one that was started
elsewhere (launch/external_agents.py), with its config as an argument. Agents and plant exchange messages over Zenoh.

A machine of the cluster loads this module, and needs what an agent needs and no more: the rest is loaded late.
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
"""Ray starts an agent again each time that it dies: `Restarts` decides when it stays down."""
READY = "ready: "
"""how the line begins that an agent logs once it has reached the router and has its place"""
MOST_PER_CPU = 20
"""Each is a whole Python process, with all of Ray in it."""
WAIT_S = 120.0
"""How long agents have to be placed and to come, if the user says nothing else."""
SOONER = 0.8
"""They give up before we do, and say why."""
LOOK_EVERY_S = 0.5
END_DEADLINE_S = 2.0
"""How long agents have to leave by themselves, and to say their last lines, once the plant has ended."""


class RemoteAgent:
    """One agent, in a worker of Ray on some machine; two threads: one is the agent, one says how it does."""

    def __init__(self) -> None:
        self._said: list[str] = []

    def run(self, config: Config, wait_s: float, credentials: Credentials | None) -> str:
        """Be the agent until the plant says END; why that could not be, or nothing."""
        from hedgerow.agents.standalone import take_part  # noqa: PLC0415
        from hedgerow.wire.child import Line  # noqa: PLC0415
        from hedgerow.wire.runtime import share_the_cores  # noqa: PLC0415

        listener = _Lines(self._said)
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
        """Return how long this life waits for the router [s]: if restarted, as long as `up` restarts its own agents."""
        import ray  # noqa: PLC0415

        restarted = ray.get_runtime_context().was_current_actor_reconstructed
        return max(wait_s, UNREACHED_S) if restarted else wait_s

    def look(self, seen: int) -> tuple[str, int, list[str]]:
        """The machine's address, the process id, and what was logged but for `seen` lines."""
        import ray  # noqa: PLC0415

        return ray.util.get_node_ip_address(), os.getpid(), self._said[seen:]


class _Lines(logging.Handler):
    def __init__(self, lines: list[str]) -> None:
        super().__init__(logging.INFO)
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append(self.format(record))


@dataclass
class _Placed:
    """One agent as we see it from here."""

    name: str
    actor: Any
    running: Any
    """what its `run` will return"""
    looking: Any = None
    """what its `look` will return"""
    pid: int = 0
    where: str = ""
    seen: int = 0
    """lines of its log that are here"""
    reached: bool = False
    """this life has reached the router"""
    restarts: Restarts = field(default_factory=Restarts)
    over: bool = False
    """its `run` has returned"""
    last: bool = False
    """when it was asked last, it was over: after that answer its log is whole"""
    told: bool = False
    """and that answer is here"""


@dataclass
class Fleet:
    """All agents of a run on a cluster."""

    on: OnRay
    folder: RunFolder
    on_change: Callable[[], None]
    say: Callable[[str], None]
    restarts: int = 0
    down: list[str] = field(default_factory=list)
    """those that ended and stay down, and why"""

    @property
    def _ray(self) -> Any:
        return self.on.cluster.ray

    @property
    def reason(self) -> str:
        """Why there is nothing to wait for: somebody could not begin."""
        return self.down[0] if self.down else ""

    @contextlib.contextmanager
    def placed(self, told: Sequence[tuple[Config, Credentials | None]], wait_s: float) -> Iterator[None]:
        """Agents with these configs, and credentials where the network is secure, while the block lasts."""
        seat = self._ray.remote(RemoteAgent).options(
            num_cpus=self.on.share,
            scheduling_strategy="SPREAD",
            max_restarts=ALWAYS,
            max_task_retries=ALWAYS,
            max_concurrency=2,
        )
        agents = []
        over = threading.Event()
        try:
            for config, own in told:
                actor = seat.remote()
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
                with contextlib.suppress(Exception):  # of a cluster that is gone itself
                    self._ray.kill(agent.actor)

    def _watch(self, agents: Sequence[_Placed], over: threading.Event) -> None:
        try:
            self._tend(agents, over)
        except Exception as error:  # the run needs Ray no more, as long as nobody dies
            why = (str(error).strip() or type(error).__name__).splitlines()[0]
            self.say(f"--on {self.on.cluster.address}: out of reach: {why}; the logs of agents end here")

    def _tend(self, agents: Sequence[_Placed], over: threading.Event) -> None:
        """Bring logs here, and see who dies, until `over` and then until all have left, or should have."""
        everybody = False
        while not over.wait(LOOK_EVERY_S):
            self._look(agents)
            if not everybody and all(agent.pid for agent in agents):
                everybody = True
                self.say(f"Ray has placed {_where(agents)}")
        by = time.monotonic() + END_DEADLINE_S
        self._ray.wait([agent.running for agent in agents], num_returns=len(agents), timeout=END_DEADLINE_S)
        while time.monotonic() < by and not all(agent.told for agent in agents):
            self._look(agents)

    def _look(self, agents: Sequence[_Placed]) -> None:
        ray = self._ray
        for agent in agents:
            if agent.looking is None and not agent.told:
                agent.last = agent.over
                agent.looking = agent.actor.look.options(max_task_retries=0).remote(agent.seen)
        waiting = [ref for one in agents for ref in (one.looking, None if one.over else one.running) if ref is not None]
        if not waiting:
            return
        ready, _ = ray.wait(waiting, num_returns=len(waiting), timeout=LOOK_EVERY_S)
        for agent in agents:
            if agent.looking in ready:
                with contextlib.suppress(ray.exceptions.RayError):  # it died, or is not there yet
                    self._take(agent, *ray.get(agent.looking))
                agent.looking, agent.told = None, agent.last
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
            # What we asked for was counted in the log of its life before.
            lines = [f"-- {'again ' if again else ''}on {where}, process {pid}", *([] if again else lines)]
            if again and agent.restarts.after_death(agent.reached, time.monotonic()) is None:
                self._ray.kill(agent.actor)  # its `run` ends with that, and it is down
            agent.where, agent.pid, agent.seen, agent.reached = where, pid, -1, False
        agent.seen += len(lines)
        agent.reached = agent.reached or any(READY in line for line in lines)
        if lines:
            with contextlib.suppress(OSError), (self.folder.logs / f"{agent.name}.log").open("a") as log:
                log.writelines(f"{line}\n" for line in lines)


def share_of(agents: int, free: float, machines: int) -> float:
    """The CPUs that each agent asks Ray for: one where there are enough, else such a part of one that all fit."""
    if agents <= free:
        return 1.0
    # What is left over on a machine is less than a share.
    share = int(1e4 * free / (agents + machines)) / 1e4
    if share * MOST_PER_CPU < 1:
        most = int(free * MOST_PER_CPU) - machines
        raise UserError(
            f"--on ray: {agents} agent process{'es' * (agents != 1)} are too many for a cluster with {free:g} free CPUs"
            f" on {machines} machine{'s' * (machines != 1)}, {MOST_PER_CPU} a CPU at most: add machines, end what runs"
            " there" + (f", or put several nodes in a process, --processes {most}" if most > 0 else ""),
            code=Code.OPTION,
        )
    return share


def _where(agents: Sequence[_Placed]) -> str:
    """Who is where, in words."""
    machines = dict.fromkeys(agent.where for agent in agents)
    names = {where: [agent.name for agent in agents if agent.where == where] for where in machines}
    return "; ".join(
        f"{', '.join(some[:8])}{f' and {len(some) - 8} more' if len(some) > 8 else ''} on {where}"
        for where, some in names.items()
    )


@dataclass(frozen=True)
class OnRay:
    """The agents of a network as they will be on a cluster."""

    cluster: RayCluster
    external: External
    endpoint: str
    """where they find the run"""
    share: float
    """the CPUs that each asks for"""


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
    """What `--on ON` means, while we are joined to that cluster; UserError where it cannot be."""
    from hedgerow.orchestrator.launch import endpoints, external_agents  # noqa: PLC0415
    from hedgerow.orchestrator.launch.ray_cluster import joined  # noqa: PLC0415
    from hedgerow.wire.ports import LOOPBACK, free_port  # noqa: PLC0415

    with joined(on) as cluster:
        # Nobody else is let in where there is nobody else.
        here = LOOPBACK if cluster.machines <= {cluster.here} else cluster.here
        listens = None if router else listen or f"{'tls' if topology.secure else 'tcp'}/{here}:{free_port(here)}"
        meet = namespace or endpoints.namespace_of(topology.name)
        share = share_of(len(shards), cluster.free_cpus, len(cluster.machines))
        everybody = external_agents.chosen("all", topology, shards, router, listens, meet, wait_s or WAIT_S)
        yield OnRay(cluster, everybody, router or external_agents.local(listens or "", here), share)
