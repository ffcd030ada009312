"""Separate processes of a run, which the user starts on any machine: their choice, their configs, their meeting.

They receive the same data as a process that `up` forks, in a separate TOML text (wire.config). They meet in a namespace
that is known in advance. The plant refuses a process with another network, release or message format (wire.handshake).
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import zenoh

from hedgerow.agents.law_source import source_digest
from hedgerow.orchestrator.ground.assignment import Layout, process_name, truth_of, views_of
from hedgerow.orchestrator.launch.control import ask
from hedgerow.orchestrator.launch.endpoints import Connection
from hedgerow.topologies.errors import Code, DeadlineError, HedgerowError, UserError
from hedgerow.topologies.paths import real_path
from hedgerow.topologies.regular_file import open_regular
from hedgerow.topologies.resolve import digest
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.access import OBSERVER
from hedgerow.wire.config import Config
from hedgerow.wire.handshake import introduction
from hedgerow.wire.session import WireError, direct

PLANT_GONE_S = 30.0
"""The time that the plant may be out of sight before the run ends [s]; reconnecting a cable takes less."""
PLANT = -1
"""The number of the plant, beside the numbers of shards."""
_MOST_LOG = 2**20
"""the maximum number of bytes of a log in one read"""
OWN_START_S = 60.0
"""The additional start time of our own processes, beyond the wait for the separate ones [s]."""
ANY_HOST = ("0.0.0.0", "[::]")


@dataclass(frozen=True)
class External:
    """The separate processes of a run, and the endpoint, namespace and names that all use."""

    shards: frozenset[int]
    plant: bool
    names: Sequence[str]
    """the names of all processes, for display"""
    namespace: str
    network: str
    """the fingerprint of the network"""
    listen: str | None
    """the endpoint of our own plant for them; None if there is a router"""
    wait_s: float
    """the time that they have to come [s]"""

    def __contains__(self, process: int) -> bool:
        """Return True if a process, a shard or PLANT, is started separately."""
        return self.plant if process == PLANT else process in self.shards

    def connection(self, router: str | None, keys: Path | None) -> Connection:
        """Return the connection of our own processes: an existing router, or the port that our plant opens."""
        endpoint = router or local(self.listen or "")
        return Connection(endpoint, self.namespace, listens=router is None, credentials=keys and real_path(keys))

    def __str__(self) -> str:
        return ", ".join(self.names)


def chosen(
    asked: str,
    topology: Topology,
    shards: Layout,
    router: str | None,
    listen: str | None,
    namespace: str,
    wait_s: float,
) -> External:
    """Return the processes in `--external ASKED`: `all`, `plant`, ids of nodes and names of processes, separated by
    commas.

    Raise UserError for an unknown name, and if separate processes could not reach us.
    """
    names = [process_name(view) for view in views_of(topology, shards)]
    nodes = {str(topology.ids[k]): p for p, shard in enumerate(shards) for k in shard}
    processes = {name: p for p, name in enumerate(names)}
    home = nodes | processes
    words = [word for part in asked.split(",") if (word := part.strip())]
    for word in words:
        as_process = 0 if word in ("all", keys.PLANT) else processes.get(word)
        if word in nodes and as_process is not None and (word not in processes or as_process != nodes[word]):
            raise UserError(
                f"--external {asked}: {word} is a node, and a word for other processes; write {names[nodes[word]]} for"
                " the process of the node, or rename the node",
                code=Code.OPTION,
            )
    unknown = [word for word in words if word not in home and word not in ("all", keys.PLANT)]
    if unknown or not words:
        raise UserError(
            f"--external {asked}: there is no {', '.join(unknown) or 'name in it'};"
            f" name nodes, `plant` or `all`; the processes are {', '.join([keys.PLANT, *names][:12])}"
        )
    wanted = set(range(len(shards))) if "all" in words else {home[word] for word in words if word != keys.PLANT}
    plant = keys.PLANT in words
    if plant and router is None:
        raise UserError("--external plant: give its router, e.g. --router tcp/bench:7447")
    if plant and listen:
        raise UserError("--listen is for our own plant: give it to the separate plant")
    if router is None and listen is None:
        raise UserError(
            "--external: the separate processes need an address. --listen tcp/0.0.0.0:7447 opens a port on this"
            " machine, and --router tcp/host:7447 uses an existing Zenoh router"
        )
    return External(
        frozenset(wanted),
        plant,
        [*([keys.PLANT] if plant else []), *(names[p] for p in sorted(wanted))],
        namespace,
        digest(topology),
        listen,
        wait_s,
    )


def local(endpoint: str, here: str = "127.0.0.1") -> str:
    """Return `endpoint` with our address in place of an address that means any host."""
    for host in ANY_HOST:
        endpoint = endpoint.replace(f"/{host}:", f"/{here}:")
    return endpoint


def configs(topology: Topology, shards: Layout, router: str, namespace: str) -> list[Config]:
    """Return the config of each process, the plant first; see `orchestrator bundle`."""
    network = digest(topology)
    parts = {keys.PLANT: truth_of(topology, shards).to_dict()}
    views = views_of(topology, shards, source_digest(topology.law))
    parts |= {process_name(view): view.to_dict() for view in views}
    return [Config(name, namespace, router, network, one) for name, one in parts.items()]


class Meeting:
    """The separate processes as the observer sees them: their arrival, and the presence of the plant."""

    def __init__(self, external: External, session: zenoh.Session, plant_log: Path) -> None:
        self._external, self._session = external, session
        self._log, self._read = plant_log, 0
        self._refused: set[str] = set()
        self._began = time.monotonic()
        self._changed = threading.Condition()
        self._there = False
        self._gone_at = self._began
        self.reason = ""
        """the reason why waiting is useless"""

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Watch the plant's token while the block lasts."""
        listener = direct(self._take)
        with self._session.liveliness().declare_subscriber(keys.alive(keys.PLANT, "*"), listener, history=True):
            yield

    def _take(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self._there = sample.kind == zenoh.SampleKind.PUT
            self._gone_at = time.monotonic()
            self._changed.notify_all()

    def introduce(self) -> None:
        """Wait for a separate plant, and compare versions; raise HedgerowError if they do not fit."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._there, self._external.wait_s):
                raise DeadlineError(f"plant: not there after {self._external.wait_s:g} s; is it started?")
        answer = ask(
            self._session, f"join/{OBSERVER}", {"process": "the observer", **introduction(self._external.network)}
        )
        if "error" in answer:
            raise HedgerowError(f"the plant refuses us: {answer['error']}")

    def refused(self) -> list[str]:
        """Return the new refusals of our plant's router, each cause once."""
        if not self._log.exists():
            return []
        from hedgerow.wire.refusal import refused  # noqa: PLC0415  # ssl delays the first step

        with open_regular(self._log) as log:
            log.seek(self._read)
            # Strangers can make the router write any amount: read the rest next time.
            lines = log.read(_MOST_LOG).rpartition(b"\n")[0]
        self._read += len(lines)
        found = {why for line in lines.decode(errors="replace").splitlines() if (why := refused(line))}
        self._refused, new = self._refused | found, found - self._refused
        return sorted(new)

    def is_over(self, begun: bool) -> bool:
        """Return True if no process will come any more; `reason` has the cause."""
        now = time.monotonic()
        with self._changed:
            if self._external.plant and not self._there and now - self._gone_at > PLANT_GONE_S:
                self.reason = f"the plant is gone: not seen for {PLANT_GONE_S:g} s"
        waited_s = now - self._began - self._external.wait_s
        if not begun and waited_s > 0:
            absent = self._absent()
            # One of our own processes with a separate neighbour waits for that neighbour.
            others = [who for p, who in absent.items() if p in self._external]
            if others or waited_s > OWN_START_S:
                names = (
                    ", ".join((others or list(absent.values()))[:8])
                    or "all processes are present, but the first step is missing"
                )
                self.reason = (
                    f"{names} not there after {self._external.wait_s:g} s. Start them, or give a longer --wait"
                )
        return bool(self.reason)

    def _absent(self) -> dict[int, str]:
        """Return the names of the absent processes, by shard."""
        with contextlib.suppress(WireError):
            return {int(p): name for p, name in ask(self._session, "status")["absent"].items()}
        return {PLANT: keys.PLANT}
