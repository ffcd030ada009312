"""A network as containers: a Compose file, or Kubernetes manifests, with all that each process is told in it.

The order of starting is the processes' own affair: each waits for the router, an agent for the plant, the plant for
all agents and the observer (docs/wire.md). So nothing here sleeps, and Compose and Swarm read the same file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from orchestrator.assign import Layout
from orchestrator.bundle import release
from orchestrator.external import configs
from topologies.errors import UserError
from topologies.resolve import to_yaml
from topologies.schema import Topology
from wire import keys
from wire.config import VARIABLE, Config

ROUTER_IMAGE = "eclipse/zenoh:1.10.2"
ROUTER_PORT, PAGE_PORT = 7447, 9090
ROUTER_COMMAND = (
    f"--listen=tcp/0.0.0.0:{ROUTER_PORT}",
    "--no-multicast-scouting",
    "--no-timestamp",
    "--rest-http-port=127.0.0.1:8000",
    "--cfg=transport/unicast/max_sessions:100000",
)
ROUTER_CHECK = ("wget", "-q", "-O", "/dev/null", "http://127.0.0.1:8000/@/local/router")
PAGE_CHECK = (
    "python",
    "-c",
    f"import urllib.request as r; r.urlopen('http://127.0.0.1:{PAGE_PORT}/re_viewer.js', timeout=5)",
)
WAIT_S = 600
"""How long everybody waits for all others: images may have to be pulled."""
MOST_BYTES = 100_000
"""What one environment variable may hold; the kernel's limit is 128 KB."""
MOST_MAP_BYTES = 1_000_000
"""What one ConfigMap may hold; Kubernetes' limit is 1 MiB."""
USER_ID = 10001
"""The user in both images (Dockerfile)."""


@dataclass(frozen=True)
class Containers:
    """A network, cut into containers."""

    topology: Topology
    configs: Sequence[Config]
    """the plant's first"""
    rate: float

    @property
    def namespace(self) -> str:
        """Where all meet."""
        return self.configs[0].namespace

    def command(self, config: Config) -> list[str]:
        """What the container of a plant or an agent runs."""
        if config.process == keys.PLANT:
            return ["plant", "--rate", f"{self.rate:g}", "--wait", str(WAIT_S)]
        return ["agent", "--wait", str(WAIT_S)]

    def check(self, config: Config) -> list[str]:
        """How that container asks its process whether it takes part."""
        return [self.command(config)[0], "--check"]

    def observer(self, file: str) -> list[str]:
        """What the observer's container runs."""
        return [
            *("orchestrator", "up", file, "--external", "plant,all", "--namespace", self.namespace, "--plain"),
            *("--router", self.configs[0].router, "--wait", str(WAIT_S), "--viewer", f"http://0.0.0.0:{PAGE_PORT}"),
        ]


def containers(topology: Topology, shards: Layout, namespace: str, rate: float, most_bytes: int) -> Containers:
    """The containers of a network; UserError where one would be told more than `most_bytes`."""
    told = [_named(one) for one in configs(topology, shards, f"tcp/router:{ROUTER_PORT}", namespace)]
    size, largest = max(
        [(len(one.to_toml().encode()), one.process) for one in told] + [(len(to_yaml(topology)), "file")]
    )
    if size > most_bytes:
        raise UserError(
            f"{topology.name}: {largest} is told {size} bytes, and a container at most {most_bytes}: use more"
            " --processes, or `orchestrator bundle`, whose files can be of any size"
        )
    return Containers(topology, told, rate)


def _named(config: Config) -> Config:
    """The same, under a name that every engine takes: of lower case, without dots and underscores."""
    if re.fullmatch(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?", config.process):
        return config
    return Config(keys.shard_name(config.told["shard"]), config.namespace, config.router, config.network, config.told)


def compose(one: Containers) -> str:
    """A Compose file, which `docker compose up` and `docker stack deploy` take."""
    services = [_service(one, config) for config in one.configs]
    return "\n".join([_head(one), *services, _observer(one)])


HEAD = """\
# {name}: a router, the plant, {agents} agents, and the observer, who serves the viewer's page.
# Made by `orchestrator compose`; with it, and the Dockerfile beside it:
#   docker compose up       the page is at http://localhost:{page}; the run's folder is in the volume `runs`
#   docker compose down     ends it and leaves nothing but that volume (`down --volumes`: not that either)
#   docker stack deploy -c THIS-FILE {name}       once the images are built and pushed
# Everybody waits for everybody else, so the order of starting does not matter. An agent that dies is started again and
# goes on where it would be; the plant and the observer are the run, and end with it.

x-agent: &agent
  image: hedgerow-agent:{release}
  build: {{context: ., target: agent}}
  command: {command}
  init: true
  networks: [wire]
  depends_on: [router, plant]
  restart: on-failure
  deploy: {{restart_policy: {{condition: on-failure, delay: 1s}}}}
  stop_grace_period: 5s
  healthcheck: &takes-part
    test: {check}
    interval: 10s
    timeout: 10s
    retries: 3
    start_period: {wait}s

networks:
  wire: {{}}

volumes:
  runs: {{}}

services:
  router:
    image: {router}
    command: {router_command}
    init: true
    networks: [wire]
    restart: unless-stopped
    deploy: {{restart_policy: {{condition: any}}}}
    healthcheck:
      test: {router_check}
      interval: 10s
      timeout: 5s
      retries: 3
      start_period: 10s
"""
AGENT = """\
  {process}:
    <<: *agent
    environment:
      {variable}: |
{text}
"""
PLANT = """\
  {process}:
    image: hedgerow-agent:{release}
    build: {{context: ., target: agent}}
    command: {command}
    init: true
    networks: [wire]
    depends_on: [router]
    restart: "no"
    deploy: {{restart_policy: {{condition: none}}}}
    stop_grace_period: 10s
    healthcheck:
      <<: *takes-part
      test: {check}
    environment:
      {variable}: |
{text}
"""
OBSERVER = """\
  orchestrator:
    image: hedgerow:{release}
    build: {{context: ., target: orchestrator}}
    command:
      - /bin/sh
      - -c
      - printf '%s' "$$HEDGEROW_TOPOLOGY" > topology.yaml && exec {command}
    init: true
    networks: [wire]
    depends_on: [router]
    ports: ["{page}:{page}"]
    volumes: ["runs:/home/hedgerow/runs"]
    restart: "no"
    deploy: {{restart_policy: {{condition: none}}}}
    stop_grace_period: 20s
    healthcheck:
      test: {check}
      interval: 10s
      timeout: 10s
      retries: 3
      start_period: {wait}s
    environment:
      HEDGEROW_TOPOLOGY: |
{text}
"""


def _head(one: Containers) -> str:
    agent = one.configs[-1]
    return HEAD.format(
        name=one.topology.name,
        agents=len(one.configs) - 1,
        page=PAGE_PORT,
        release=release(),
        command=_words(one.command(agent)),
        check=_test(one.check(agent)),
        wait=WAIT_S,
        router=ROUTER_IMAGE,
        router_command=_words(ROUTER_COMMAND),
        router_check=_test(ROUTER_CHECK),
    )


def _service(one: Containers, config: Config) -> str:
    form = PLANT if config.process == keys.PLANT else AGENT
    return form.format(
        process=config.process,
        release=release(),
        command=_words(one.command(config)),
        check=_test(one.check(config)),
        variable=VARIABLE,
        text=_block(config.to_toml()),
    )


def _observer(one: Containers) -> str:
    return OBSERVER.format(
        release=release(),
        command=" ".join(one.observer("topology.yaml")),
        page=PAGE_PORT,
        check=_test(PAGE_CHECK),
        wait=WAIT_S,
        text=_block(to_yaml(one.topology)),
    )


def _words(words: Sequence[str]) -> str:
    """A list on one line."""
    text: str = yaml.safe_dump(list(words), default_flow_style=True, width=10**6)
    return text.strip()


def _test(words: Sequence[str]) -> str:
    return _words(["CMD", *words])


def _block(text: str) -> str:
    """A text as a block of a Compose file, in which $ is written twice."""
    return "\n".join(f"        {line}".rstrip() for line in text.replace("$", "$$").splitlines())


def kubernetes(one: Containers) -> str:
    """Kubernetes manifests: a Deployment and a Service for the router, a Job and a ConfigMap for each process."""
    name = one.topology.name.lower().replace("_", "-").replace(".", "-")
    documents: list[Mapping[str, Any]] = [*_router(name)]
    for config in one.configs:
        again = config.process != keys.PLANT
        documents += [
            _config_map(name, config.process, "told.toml", config.to_toml()),
            _job(name, config.process, "hedgerow-agent", one.command(config), one.check(config), again),
        ]
    check = list(PAGE_CHECK)
    documents += [
        _config_map(name, "orchestrator", "topology.yaml", to_yaml(one.topology)),
        _volume_claim(name),
        _job(name, "orchestrator", "hedgerow", one.observer("/told/topology.yaml"), check, again=False),
        _page(name),
    ]
    return HEAD_KUBERNETES.format(name=name, page=PAGE_PORT) + yaml.safe_dump_all(
        documents, sort_keys=False, width=10**6, explicit_start=True
    )


HEAD_KUBERNETES = """\
# Made by `orchestrator compose --format kubernetes`; the images are those of the Dockerfile.
#   kubectl create namespace {name} && kubectl apply -n {name} -f THIS-FILE
#   kubectl port-forward -n {name} service/page {page}      the page is at http://localhost:{page}
#   kubectl delete namespace {name}
"""
SECURITY = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}


def _meta(network: str, process: str) -> dict[str, Any]:
    return {"name": process, "labels": _labels(network, process)}


def _labels(network: str, process: str) -> dict[str, str]:
    return {"app.kubernetes.io/name": "hedgerow", "app.kubernetes.io/instance": network, "hedgerow/process": process}


def _router(network: str) -> list[Mapping[str, Any]]:
    labels = _labels(network, "router")
    container = {
        "name": "router",
        "image": ROUTER_IMAGE,
        "args": list(ROUTER_COMMAND),
        "ports": [{"containerPort": ROUTER_PORT}],
        "readinessProbe": {"tcpSocket": {"port": ROUTER_PORT}, "periodSeconds": 2},
        "livenessProbe": {"exec": {"command": list(ROUTER_CHECK)}, "periodSeconds": 10, "timeoutSeconds": 5},
        "securityContext": SECURITY,
    }
    pod = {"metadata": {"labels": labels}, "spec": {"containers": [container], "automountServiceAccountToken": False}}
    return [
        {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": _meta(network, "router"),
            "spec": {"replicas": 1, "selector": {"matchLabels": labels}, "template": pod},
        },
        _a_service(network, "router", "router", ROUTER_PORT),
    ]


def _a_service(network: str, name: str, process: str, port: int) -> Mapping[str, Any]:
    spec = {"selector": _labels(network, process), "ports": [{"port": port, "targetPort": port}]}
    return {"apiVersion": "v1", "kind": "Service", "metadata": _meta(network, name), "spec": spec}


def _page(network: str) -> Mapping[str, Any]:
    return _a_service(network, "page", "orchestrator", PAGE_PORT)


def _config_map(network: str, process: str, file: str, text: str) -> Mapping[str, Any]:
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": _meta(network, process), "data": {file: text}}


def _volume_claim(network: str) -> Mapping[str, Any]:
    spec = {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "1Gi"}}}
    return {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "metadata": _meta(network, "runs"), "spec": spec}


def _job(
    network: str, process: str, image: str, command: Sequence[str], check: Sequence[str], again: bool
) -> Mapping[str, Any]:
    """One process: started `again` when it fails, or not; each is told what its own ConfigMap holds and no more."""
    observer = image == "hedgerow"
    container: dict[str, Any] = {
        "name": process,
        "image": f"{image}:{release()}",
        "command": list(command) if observer else [*command, "--config", "/told/told.toml"],
        "readinessProbe": {
            "exec": {"command": list(check) if observer else [*check, "--config", "/told/told.toml"]},
            "periodSeconds": 10,
            "timeoutSeconds": 10,
        },
        "volumeMounts": [{"name": "told", "mountPath": "/told", "readOnly": True}],
        "securityContext": SECURITY,
    }
    volumes: list[dict[str, Any]] = [{"name": "told", "configMap": {"name": process}}]
    if observer:
        container["ports"] = [{"containerPort": PAGE_PORT}]
        container["volumeMounts"].append({"name": "runs", "mountPath": "/home/hedgerow/runs"})
        volumes.append({"name": "runs", "persistentVolumeClaim": {"claimName": "runs"}})
    pod = {
        "restartPolicy": "OnFailure" if again else "Never",
        "automountServiceAccountToken": False,
        "securityContext": {"runAsNonRoot": True, "runAsUser": USER_ID, "fsGroup": USER_ID},
        "containers": [container],
        "volumes": volumes,
    }
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": _meta(network, process),
        "spec": {
            "backoffLimit": 6 if again else 0,
            "template": {"metadata": {"labels": _labels(network, process)}, "spec": pod},
        },
    }
