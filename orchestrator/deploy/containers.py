"""A network cut into containers: what each runs, is told, and has of keys, whatever engine runs them.

The order of starting is the processes' own affair: each waits for the router, an agent for the plant, the plant for
all agents and the observer (docs/wire.md). So nothing sleeps.
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
"""In the folder of its keys; without the web interface, which asks nobody for a certificate."""
SECURE_ROUTER_CHECK = ("nc", "-z", "127.0.0.1", str(ROUTER_PORT))
KEYS = "/keys"
"""The folder of keys in a container, with the folders of its own processes alone."""
ROUTER_CHECK = ("wget", "-q", "-O", "/dev/null", "http://127.0.0.1:8000/@/local/router")
PAGE_CHECK = (
    "python",
    "-c",
    f"import urllib.request as r; r.urlopen('http://127.0.0.1:{PAGE_PORT}/re_viewer.js', timeout=5)",
)
WAIT_S = 600
"""How long everybody waits for all others: images may have to be pulled."""
START_S = 120
"""How long a health check may fail before it counts: a container that never takes part is unhealthy after that."""
AGENT_MEMORY, PLANT_MEMORY, ROUTER_MEMORY, OBSERVER_MEMORY = 1024, 2048, 1024, 4096
"""Memory limits [MB]; an agent of paper7 uses 44 MB (docs/security.md). The rest is room for large networks."""
CPUS, PIDS = 1, 256
"""Limits of each container; Docker refuses more cores than the machine has."""
TEMPORARY = "/tmp"
LAW = "/law"
"""The folder of a law of the user's own in the containers of the agents and the observer."""
HOMES = tuple(f"/home/hedgerow/{name}" for name in (".cache", ".config", ".local"))
"""Where the viewer keeps its settings; nothing else but volumes can be written to."""
MOST_SECRET_BYTES = 500_000
"""What one secret may hold, of Docker Swarm; in Kubernetes it is twice as much."""

Files = Mapping[str, Sequence[str]]
"""Files in the folder of keys, by the folder in it."""
CREDENTIALS = (PRIVATE_KEY, CERTIFICATE, CA)
OBSERVERS: Files = {OBSERVER: (*CREDENTIALS, SETTINGS), OPERATOR: CREDENTIALS}
ROUTERS: Files = {ROUTER: (*CREDENTIALS, CONFIGURATION)}


@dataclass(frozen=True)
class Containers:
    """A network, cut into containers."""

    topology: Topology
    configs: Sequence[Config]
    """the plant's first"""
    rate: float
    services: Mapping[str, str]
    """what they are called here, by what they are called in the folder of keys"""
    keys: Path | None = None
    """that folder, where the network is secure"""
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
        """Where all meet."""
        return self.configs[0].namespace

    def image(self, name: str) -> str:
        """One of the two of the Dockerfile, `hedgerow` or `hedgerow-agent`."""
        return f"{self.registry}{'/' if self.registry else ''}{name}:{release()}"

    def command(self, config: Config) -> list[str]:
        """What the container of a plant or an agent runs."""
        if config.process == keys.PLANT:
            return ["hedgerow-plant", "--rate", f"{self.rate:g}", "--wait", str(WAIT_S)]
        return ["hedgerow-agent", "--wait", str(WAIT_S)]

    def check(self, config: Config) -> list[str]:
        """How that container asks its process whether it takes part."""
        return [self.command(config)[0], "--check"]

    def observer(self, file: str) -> list[str]:
        """What the observer's container runs."""
        return [
            *("orchestrator", "up", file, "--external", "plant,all", "--namespace", self.namespace, "--plain"),
            *("--router", self.configs[0].router, "--wait", str(WAIT_S), "--viewer", f"http://0.0.0.0:{PAGE_PORT}"),
            *(("--keys", KEYS) if self.keys else ()),
        ]

    def own(self, config: Config) -> Files:
        """The keys of a plant or an agent."""
        return {home: CREDENTIALS for home, service in self.services.items() if service == config.process}

    @property
    def router_command(self) -> Sequence[str]:
        """What the router's container runs."""
        return SECURE_ROUTER_COMMAND if self.keys else ROUTER_COMMAND

    @property
    def router_check(self) -> Sequence[str]:
        """How that container asks whether it runs."""
        return SECURE_ROUTER_CHECK if self.keys else ROUTER_CHECK


_REGISTRY = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]*(:[0-9]{1,5})?(/[a-z0-9]+([._-]+[a-z0-9]+)*)*/?")
"""a prefix of an image's name, by Docker's reference grammar"""


def provide_keys(folder: Path, places: Sequence[Place], namespace: str, days: float | None) -> None:
    """Make the keys of a network in containers, if `folder` is not there; UserError if it holds others."""
    if not folder.exists():
        to_carry(folder, places, namespace, SECURE_ROUTER, days or LIFE_DAYS)
    elif days is not None:
        raise UserError(f"--days {days:g}: the keys in {folder} are there already; name a new folder, --keys DIR")
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
    """The containers of a network, with keys out of `folder`; UserError where one would be told over `most_bytes`."""
    if registry and not _REGISTRY.fullmatch(registry):
        raise UserError(
            f"--registry {registry}: is no prefix of an image. Write HOST[:PORT]/PATH in lower case.", code=Code.OPTION
        )
    told = configs(topology, shards, SECURE_ROUTER if folder else f"tcp/router:{ROUTER_PORT}", namespace)
    homes = [one.process for one in told]
    if folder is not None:
        rules = (folder / ROUTER / CONFIGURATION).stat().st_size
        if rules > MOST_SECRET_BYTES:
            raise UserError(
                f"{topology.name}: the router's rules are {rules} bytes, a secret holds at most {MOST_SECRET_BYTES}:"
                " use fewer --processes, or `orchestrator bundle --secure`",
                code=Code.TOPOLOGY,
            )
        told = [replace(one, credentials=f"{KEYS}/{one.process}") for one in told]
    told = [_named(one) for one in told]
    size, largest = max(
        [(len(one.to_toml().encode()), one.process) for one in told] + [(len(to_yaml(topology)), "file")]
    )
    if size > most_bytes:
        raise UserError(
            f"{topology.name}: {largest} is told {size} bytes, and a container at most {most_bytes}: use more"
            " --processes, or `orchestrator bundle`, whose files can be of any size",
            code=Code.TOPOLOGY,
        )
    law = source_of(topology.law)
    if (size := sum(map(len, law.files.values()))) > MOST_SECRET_BYTES:
        raise UserError(
            f"law {topology.law}: its source has {size} bytes, and a container takes at most {MOST_SECRET_BYTES}. Use"
            " `orchestrator bundle`, whose files can be of any size.",
            code=Code.LAW,
        )
    services = dict(zip(homes, (one.process for one in told), strict=True))
    return Containers(topology, told, rate, services, folder, registry.rstrip("/"), law)


def _named(config: Config) -> Config:
    """The same, under a name that every engine takes: of lower case, without dots and underscores."""
    if re.fullmatch(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?", config.process):
        return config
    return replace(config, process=keys.shard_name(config.told["shard"]))
