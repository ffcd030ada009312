"""A network as a Compose file, with the config of each process in it, for Docker Compose and Docker Swarm."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import yaml

from hedgerow.orchestrator.deploy.containers import (
    AGENT_MEMORY,
    CPUS,
    CREDENTIALS,
    HOMES,
    KEYS,
    LAW,
    OBSERVER_MEMORY,
    OBSERVERS,
    PAGE_CHECK,
    PAGE_PORT,
    PIDS,
    PLANT_MEMORY,
    ROUTER_IMAGE,
    ROUTER_MEMORY,
    ROUTERS,
    START_S,
    TEMPORARY,
    Containers,
    Files,
)
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.escape import command, escape
from hedgerow.topologies.resolve import to_yaml
from hedgerow.wire import keys
from hedgerow.wire.access import ROUTER
from hedgerow.wire.config import VARIABLE, Config

MOST_BYTES = 100_000
"""The maximum length of one environment variable; the kernel's limit is 128 KB."""


def to_compose(one: Containers, folder: Path) -> str:
    """Return a Compose file for `docker compose up` and `docker stack deploy`, to be written into `folder`."""
    services = [_service(one, config) for config in one.configs]
    return "\n".join([_head(one), *services, _observer(one), *_law_files(one), *_all_secrets(one, folder)])


HEAD = """\
# {name}: a router, the plant, {agents} agents, and the observer, which serves the viewer's page.
# Made by `orchestrator compose`. Commands, with the Dockerfile beside this file:
#   docker compose up       the page is at http://localhost:{page}; the run's folder is in the volume `runs`
#   docker compose down     ends it and keeps only that volume (`down --volumes`: not even that)
#   docker stack deploy -c THIS-FILE {name}       once the images are built and pushed
# All processes wait for each other, so the order of their start does not matter. An agent that dies is restarted and
# rejoins the run. The plant and the observer end with the run.
{secure}
x-agent: &agent
  image: {image}
  build: {{context: ., target: agent}}
  command: {command}
  init: true
  networks: [wire]
  depends_on: [router, plant]
  restart: on-failure
  deploy: {{restart_policy: {{condition: on-failure, delay: 1s}}, {agent_limits}}}
{confined_agent}{law}  stop_grace_period: 5s
{user}  healthcheck: &takes-part
    test: {check}
    interval: 10s
    timeout: 10s
    retries: 3
    start_period: {start}s

networks:
  wire: {{}}

volumes:
  runs: {{}}

services:
  router:
    image: {router}
    command: {router_command}
{router_keys}    init: true
    networks: [wire]
    restart: unless-stopped
    deploy: {{restart_policy: {{condition: any}}, {limits}}}
{confined}    healthcheck:
      test: {router_check}
      interval: 10s
      timeout: 5s
      retries: 3
      start_period: 10s
"""
HEAD_SECURE = """\
# Secure: every service has only its own keys from {keys}/, and runs as the user who made them.
"""
AGENT = """\
  {process}:
    <<: *agent
{own_keys}    environment:
{law_path}      {variable}: |
{text}
"""
PLANT = """\
  {process}:
    image: {image}
    build: {{context: ., target: agent}}
    command: {command}
    init: true
    networks: [wire]
    depends_on: [router]
    restart: "no"
    deploy: {{restart_policy: {{condition: none}}, {limits}}}
{confined}    stop_grace_period: 10s
    healthcheck:
      <<: *takes-part
      test: {check}
{own_keys}    environment:
      {variable}: |
{text}
"""
OBSERVER = """\
  orchestrator:
    image: {image}
    build: {{context: ., target: orchestrator}}
    command:
      - /bin/sh
      - -c
      - |-
        printf '%s' "$$HEDGEROW_TOPOLOGY" > runs/topology.yaml && exec {command}
    init: true
    networks: [wire]
    depends_on: [router]
    ports: ["127.0.0.1:{page}:{page}"]
    volumes: ["runs:/home/hedgerow/runs"]
    restart: "no"
    deploy: {{restart_policy: {{condition: none}}, {limits}}}
{confined}    stop_grace_period: 20s
    healthcheck:
      test: {check}
      interval: 10s
      timeout: 10s
      retries: 3
      start_period: {start}s
{law}{own_keys}    environment:
{law_path}      HEDGEROW_TOPOLOGY: |
{text}
"""


def _head(one: Containers) -> str:
    agent = one.configs[-1]
    return HEAD.format(
        name=one.topology.name,
        agents=len(one.configs) - 1,
        page=PAGE_PORT,
        image=one.image("hedgerow-agent"),
        command=_words(one.command(agent)),
        check=_test(one.check(agent)),
        start=START_S,
        confined=_confined("    "),
        confined_agent=_confined("  "),
        limits=_limits(ROUTER_MEMORY),
        agent_limits=_limits(AGENT_MEMORY),
        router=ROUTER_IMAGE,
        router_command=_words(one.router_command),
        router_check=_test(one.router_check),
        router_keys=_own_keys(one, ROUTERS, f"    {_user()}    working_dir: {KEYS}/{ROUTER}\n"),
        secure=HEAD_SECURE.format(keys=escape(str(one.keys), keep="")) if one.keys else "",
        user=f"  {_user()}" if one.keys else "",
        law=_law(one, "  "),
    )


def _service(one: Containers, config: Config) -> str:
    form = PLANT if config.process == keys.PLANT else AGENT
    return form.format(
        process=config.process,
        law_path=_law_path(one),
        confined=_confined("    "),
        limits=_limits(PLANT_MEMORY),
        image=one.image("hedgerow-agent"),
        command=_words(one.command(config)),
        check=_test(one.check(config)),
        own_keys=_own_keys(one, one.own(config), f"    {_user()}" if config.process == keys.PLANT else ""),
        variable=VARIABLE,
        text=_block(config.to_toml()),
    )


def _observer(one: Containers) -> str:
    return OBSERVER.format(
        image=one.image("hedgerow"),
        command=command(one.observer("runs/topology.yaml")).replace("$", "$$"),
        law=_law(one, "    "),
        law_path=_law_path(one),
        own_keys=_own_keys(one, OBSERVERS, f"    {_user()}"),
        page=PAGE_PORT,
        check=_test(PAGE_CHECK),
        start=START_S,
        confined=_confined("    ", HOMES),
        limits=_limits(OBSERVER_MEMORY),
        text=_block(to_yaml(one.topology)),
    )


def _confined(indent: str, more: Sequence[str] = ()) -> str:
    """Return the limits of a container: no capabilities, no new privileges, and no file outside its volumes."""
    lines = (
        "cap_drop: [ALL]",
        "security_opt: ['no-new-privileges:true']",
        "read_only: true",
        f"pids_limit: {PIDS}",
        f"tmpfs: {_words([TEMPORARY, *more])}",
    )
    return "".join(f"{indent}{line}\n" for line in lines)


def _limits(megabytes: int) -> str:
    """Return the limits of a container, which both Compose and Swarm read in `deploy`."""
    return f"resources: {{limits: {{memory: {megabytes}M, cpus: '{CPUS}'}}}}"


def _user() -> str:
    """Return the user of a container: the owner of the key files; Swarm lets every user in it read them."""
    return f'user: "{os.getuid()}:{os.getgid()}"\n'


def _own_keys(one: Containers, files: Files, more: str) -> str:
    """Return the secrets of a service, and `more`."""
    if one.keys is None:
        return ""
    lines = [
        f"      - {{source: {one.services.get(home, home)}-{file}, target: {KEYS}/{home}/{file}}}\n"
        for home, some in files.items()
        for file in some
    ]
    return "".join([more, "    secrets:\n", *lines])


def _all_secrets(one: Containers, beside: Path) -> list[str]:
    """Return the places of all keys, relative to the folder of the file."""
    if one.keys is None:
        return []
    folder = one.keys if one.keys.is_absolute() else f"./{os.path.relpath(one.keys, beside)}"
    files = {**ROUTERS, **dict.fromkeys(one.services, CREDENTIALS), **OBSERVERS}
    lines = [
        f"  {one.services.get(home, home)}-{file}: {{file: {_path(f'{folder}/{home}/{file}')}}}"
        for home, some in files.items()
        for file in some
    ]
    return ["\n".join(["secrets:", *lines, ""])]


def _law(one: Containers, indent: str) -> str:
    """Return the files of a law of the user's own that a container has."""
    places = [_path(f"{LAW}/{file}") for file in one.law.files]
    lines = [f"{indent}  - {{source: law-{k}, target: {place}}}\n" for k, place in enumerate(places)]
    return "".join([f"{indent}configs:\n", *lines]) if lines else ""


def _law_path(one: Containers) -> str:
    return f"      PYTHONPATH: {LAW}\n" if one.law.files else ""


def _law_files(one: Containers) -> list[str]:
    """Return where these files lie, from the folder of the Compose file."""
    lines = [f"  law-{k}: {{file: {_path(f'./{one.law_folder}/{file}')}}}" for k, file in enumerate(one.law.files)]
    return ["\n".join(["configs:", *lines, ""])] if lines else []


def _path(path: str) -> str:
    """Return a path as a value of a Compose file, which writes $ twice; raise UserError if it is not text."""
    try:
        path.encode()
    except UnicodeEncodeError:
        raise UserError(f"--keys {path}: a Compose file is UTF-8, and this path is not. Name another folder.") from None
    text: str = yaml.safe_dump(path.replace("$", "$$"), default_style='"', allow_unicode=True, width=10**6)
    return text.strip()


def _words(words: Sequence[str]) -> str:
    """Return a list on one line."""
    text: str = yaml.safe_dump(list(words), default_flow_style=True, width=10**6)
    return text.strip()


def _test(words: Sequence[str]) -> str:
    return _words(["CMD", *words])


def _block(text: str) -> str:
    """Return a text as a block of a Compose file, which writes $ twice."""
    return "\n".join(f"        {line}".rstrip() for line in text.replace("$", "$$").splitlines())
