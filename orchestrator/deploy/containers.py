"""A network divided into containers: the command, the config and the keys of each, for any container engine.

The processes themselves determine the order of their start. Each waits for the router, an agent for the plant, and the
plant for all agents and the observer (docs/wire.md). So no container sleeps.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from hedgerow.agents.law_source import LawSource, source_of
from hedgerow.orchestrator.deploy.bundle import release
from hedgerow.orchestrator.ground.assignment import Layout
from hedgerow.orchestrator.launch.certificates import CONFIGURATION, LIFE_DAYS, SETTINGS, carried, to_carry
from hedgerow.orchestrator.launch.external_agents import configs
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.resolve import to_yaml
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.access import OBSERVER, OPERATOR, ROUTER, Place
from hedgerow.wire.config import Config
from hedgerow.wire.credentials import CA, CERTIFICATE, PRIVATE_KEY
from hedgerow.wire.session import MAX_SESSIONS, base_settings

ROUTER_IMAGE = "eclipse/zenoh:1.10.2"
ROUTER_PORT, PAGE_PORT = 7447, 9090
SECURE_ROUTER = f"tls/router:{ROUTER_PORT}"
ROUTER_COMMAND = (
    f"--listen=tcp/0.0.0.0:{ROUTER_PORT}",
    "--no-multicast-scouting",
    "--no-timestamp",
    "--rest-http-port=127.0.0.1:8000",
    f"--cfg=transport/unicast/max_sessions:{MAX_SESSIONS}",
    f"--cfg=transport/link/tx/lease:{base_settings()['transport/link/tx/lease']}",
)
SECURE_ROUTER_COMMAND = (f"--config={CONFIGURATION}",)
"""Runs in the folder of its keys; without the web interface, which does not ask for a certificate."""
SECURE_ROUTER_CHECK = ("nc", "-z", "127.0.0.1", str(ROUTER_PORT))
KEYS = "/keys"
"""The folder of keys in a container, with the folders of its processes alone."""
ROUTER_CHECK = ("wget", "-q", "-O", "/dev/null", "http://127.0.0.1:8000/@/local/router")
PAGE_CHECK = (
    "python",
    "-c",
    f"import urllib.request as r; r.urlopen('http://127.0.0.1:{PAGE_PORT}/re_viewer.js', timeout=5)",
)
WAIT_S = 600
"""The time that each process waits for the others [s]: the engine may have to pull images."""
START_S = 120
"""The time that a health check may fail at the start [s]; after it, the container counts as unhealthy."""
AGENT_MEMORY, PLANT_MEMORY, ROUTER_MEMORY, OBSERVER_MEMORY = 1024, 2048, 1024, 4096
"""Memory limits [MB]; an agent of paper7 uses 44 MB (docs/security.md). The rest is room for large networks."""
CPUS, PIDS = 1, 256
"""Limits of each container; Docker refuses more cores than the machine has."""
TEMPORARY = "/tmp"
LAW = "/law"
"""The folder of a law of the user's own in the containers of the agents and the observer."""
HOMES = tuple(f"/home/hedgerow/{name}" for name in (".cache", ".config", ".local"))
"""The folders of the viewer's settings; only these and the volumes are writable."""
MOST_SECRET_BYTES = 500_000
"""The maximum size of a secret in Docker Swarm; Kubernetes permits twice as much."""

Files = Mapping[str, Sequence[str]]
"""Files in the folder of keys, by the folder in it."""
CREDENTIALS = (PRIVATE_KEY, CERTIFICATE, CA)
OBSERVERS: Files = {OBSERVER: (*CREDENTIALS, SETTINGS), OPERATOR: CREDENTIALS}
ROUTERS: Files = {ROUTER: (*CREDENTIALS, CONFIGURATION)}


@dataclass(frozen=True)
class Containers:
    """A network divided into containers."""

    topology: Topology
    configs: Sequence[Config]
    """the config of the plant first"""
    rate: float
    services: Mapping[str, str]
    """the names of the services, by the names in the folder of keys"""
    keys: Path | None = None
    """that folder, in a secure network"""
    registry: str = ""
    """where the images are, e.g. registry.example/team; on the machine itself if it is empty"""
    law: LawSource = field(default_factory=LawSource)
    """the source of a law of the user's own"""

    @property
    def law_folder(self) -> str:
        """Return the name of the folder beside the Compose file that holds the source of the law."""
        return f"law-{self.law.digest}"

    @property
    def namespace(self) -> str:
        """Return the namespace of the network."""
        return self.configs[0].namespace

    def image(self, name: str) -> str:
        """Return one of the two images of the Dockerfile, `hedgerow` or `hedgerow-agent`."""
        return f"{self.registry}{'/' if self.registry else ''}{name}:{release()}"

    def command(self, config: Config) -> list[str]:
        """Return the command of the container of a plant or an agent."""
        if config.process == keys.PLANT:
            return ["hedgerow-plant", "--rate", f"{self.rate:g}", "--wait", str(WAIT_S)]
        return ["hedgerow-agent", "--wait", str(WAIT_S)]

    def check(self, config: Config) -> list[str]:
        """Return the command by which that container probes its process."""
        return [self.command(config)[0], "--check"]

    def observer(self, file: str) -> list[str]:
        """Return the command of the observer's container."""
        return [
            *("orchestrator", "up", file, "--external", "plant,all", "--namespace", self.namespace, "--plain"),
            *("--router", self.configs[0].router, "--wait", str(WAIT_S), "--viewer", f"http://0.0.0.0:{PAGE_PORT}"),
            *(("--keys", KEYS) if self.keys else ()),
        ]

    def own(self, config: Config) -> Files:
        """Return the keys of a plant or an agent."""
        return {home: CREDENTIALS for home, service in self.services.items() if service == config.process}

    @property
    def router_command(self) -> Sequence[str]:
        """Return the command of the router's container."""
        return SECURE_ROUTER_COMMAND if self.keys else ROUTER_COMMAND

    @property
    def router_check(self) -> Sequence[str]:
        """Return the command by which that container probes the router."""
        return SECURE_ROUTER_CHECK if self.keys else ROUTER_CHECK


_REGISTRY = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]*(:[0-9]{1,5})?(/[a-z0-9]+([._-]+[a-z0-9]+)*)*/?")
"""a prefix of an image's name, by Docker's reference grammar"""


def provide_keys(folder: Path, places: Sequence[Place], namespace: str, days: float | None) -> None:
    """Make the keys of a network in containers, if `folder` does not exist; raise UserError if it has other keys."""
    if not folder.exists():
        to_carry(folder, places, namespace, SECURE_ROUTER, days or LIFE_DAYS)
    elif days is not None:
        raise UserError(f"--days {days:g}: the keys in {folder} already exist; name a new folder, --keys DIR")
    made_for = carried(folder, places)
    if made_for != (SECURE_ROUTER, namespace):
        raise UserError(
            f"--keys {folder}: made for {made_for[0]} and {made_for[1]}, and the containers meet at {SECURE_ROUTER} and"
            f" {namespace}; name a new folder, which is filled then"
        )


def containers(
    topology: Topology,
    shards: Layout,
    namespace: str,
    rate: float,
    most_bytes: int,
    folder: Path | None = None,
    registry: str = "",
) -> Containers:
    """Return the containers of a network, with keys from `folder`; raise UserError if a config is larger than
    `most_bytes`.
    """
    if registry and not _REGISTRY.fullmatch(registry):
        raise UserError(
            f"--registry {registry}: is no prefix of an image. Write HOST[:PORT]/PATH in lower case.", code=Code.OPTION
        )
    if isinstance(topology.nodes, Nodes):
        raise UserError(
            f"{topology.name}: {len(topology.ids):,} nodes lie in a table, which no configuration of a container"
            " holds. Use `orchestrator bundle`, with files of any size.",
            code=Code.TOPOLOGY,
        )
    processes = configs(topology, shards, SECURE_ROUTER if folder else f"tcp/router:{ROUTER_PORT}", namespace)
    homes = [one.process for one in processes]
    if folder is not None:
        rules = (folder / ROUTER / CONFIGURATION).stat().st_size
        if rules > MOST_SECRET_BYTES:
            raise UserError(
                f"{topology.name}: the router's rules are {rules} bytes, a secret holds at most {MOST_SECRET_BYTES}:"
                " use fewer --processes, or `orchestrator bundle --secure`",
                code=Code.TOPOLOGY,
            )
        processes = [replace(one, credentials=f"{KEYS}/{one.process}") for one in processes]
    processes = [_named(one) for one in processes]
    size, largest = max(
        [(len(one.to_toml().encode()), one.process) for one in processes] + [(len(to_yaml(topology)), "file")]
    )
    if size > most_bytes:
        raise UserError(
            f"{topology.name}: {largest} needs {size} bytes, and a container accepts at most {most_bytes}: use more"
            " --processes, or `orchestrator bundle`, with files of any size",
            code=Code.TOPOLOGY,
        )
    law = source_of(topology.law)
    if (size := sum(map(len, law.files.values()))) > MOST_SECRET_BYTES:
        raise UserError(
            f"law {topology.law}: its source has {size} bytes, and a container accepts at most {MOST_SECRET_BYTES}. Use"
            " `orchestrator bundle`, with files of any size.",
            code=Code.LAW,
        )
    services = dict(zip(homes, (one.process for one in processes), strict=True))
    return Containers(topology, processes, rate, services, folder, registry.rstrip("/"), law)


def _named(config: Config) -> Config:
    """Return the same config under a name that every engine accepts: lower case, without dots and underscores."""
    if re.fullmatch(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?", config.process):
        return config
    return replace(config, process=keys.shard_name(config.part["shard"]))
