"""docker-compose.yml and the Kubernetes manifests: valid by their published schemas, and, the former, executed.

There need be no container engine: each service runs its command, with its environment, on a machine of its own.
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from tests.machines import ROOT, ROUTER, Machines, Program, machines, scripts
from tests.processes import DEADLINE_S, orchestrator, parquet_bytes

FILE = ROOT / "docker-compose.yml"


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    found: dict[str, Any] = unescaped(yaml.safe_load(FILE.read_text()))["services"]
    return found


def unescaped(value: Any) -> Any:
    """What an engine makes of a value: $$ is $, and a single $ would be a variable."""
    if isinstance(value, dict):
        return {key: unescaped(one) for key, one in value.items()}
    if isinstance(value, list):
        return [unescaped(one) for one in value]
    if isinstance(value, str):
        assert not re.search(r"(?<!\$)\$(?!\$)", value.replace("$$", "")), value
        return value.replace("$$", "$")
    return value


def test_the_file_here_is_what_the_command_prints() -> None:
    done = orchestrator("compose", "paper7")
    assert done.returncode == 0, done.stderr
    assert done.stdout == FILE.read_text(), "make it again: orchestrator compose paper7 > docker-compose.yml"


@pytest.mark.parametrize("words", [(), ("paper7",), ("grid16", "--processes", "3")], ids=str)
def test_it_is_valid_by_the_schema_of_compose(here: Path, words: tuple[str, ...]) -> None:
    vendor = resources.files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json"
    schema = json.loads(vendor.read_text(encoding="utf-8"))
    text = orchestrator("compose", *words).stdout if words else FILE.read_text()
    jsonschema.validate(yaml.safe_load(text), schema)


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="there is no docker-compose")
def test_docker_compose_takes_it() -> None:
    # The system's, in its own Python: what ours finds must not be in its way.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    words = ("docker-compose", "-f", str(FILE), "config", "--quiet")
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def test_docker_stack_deploy_takes_it_too(services: dict[str, Any]) -> None:
    for name, service in services.items():
        assert isinstance(service.get("depends_on", []), list), f"{name}: Swarm knows no conditions"
        assert service["image"].rpartition(":")[2] not in ("", "latest"), (
            f"{name}: Swarm does not build: a pinned image"
        )
        assert service["deploy"]["restart_policy"]["condition"] in ("any", "on-failure", "none"), name
        assert "container_name" not in service, name


def test_one_port_is_published_and_every_service_says_how_it_is(services: dict[str, Any]) -> None:
    assert [port for service in services.values() for port in service.get("ports", [])] == ["9090:9090"]
    for name, service in services.items():
        assert service["healthcheck"]["test"][0] == "CMD", name
        assert "sleep" not in json.dumps(service), name
    assert services["router"]["image"] == f"eclipse/zenoh:{version('eclipse-zenoh')}"


def test_no_agent_is_told_what_is_not_its_own(services: dict[str, Any]) -> None:
    truth = yaml.safe_load(services["orchestrator"]["environment"]["HEDGEROW_TOPOLOGY"])["nodes"]
    for node in truth:
        told = services[f"agent-{node}"]["environment"]["HEDGEROW_CONFIG"]
        for other in truth:
            assert (other == node) == all(str(one) in told for one in truth[other]["candidates"])
        assert "disturbance" not in told


def until(ready: Callable[[], bool], what: str) -> None:
    by = time.monotonic() + DEADLINE_S
    while not ready():
        assert time.monotonic() < by, what
        threading.Event().wait(0.05)


class Engine:
    """Runs the services of a Compose file, each on a machine of its own."""

    def __init__(self, services: dict[str, Any], lab: Machines, folder: Path) -> None:
        self.services, self.lab, self.folder = services, lab, folder
        path = f"{scripts(folder / 'bin')}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.environment = {"PATH": path, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(folder)}
        self.programs: dict[str, Program] = {}

    def start(self, name: str) -> None:
        service = self.services[name]
        words = service["command"]
        if service["image"].startswith("eclipse/zenoh:"):
            listen = next(word.partition("=")[2] for word in words if word.startswith("--listen="))
            words = [sys.executable, "-c", ROUTER, listen]
        environment = self.environment | service.get("environment", {})
        self.programs[name] = Program(self.lab.on(name), words, self.folder / name, environment)

    def is_healthy(self, name: str) -> bool:
        service = self.services[name]
        environment = {**os.environ, **self.environment, **service.get("environment", {})}
        words = [*self.lab.on(name), *service["healthcheck"]["test"][1:]]
        return subprocess.run(words, env=environment, capture_output=True, check=False).returncode == 0

    def said(self, name: str) -> str:
        return self.programs[name].log.read_text()

    def end(self) -> None:
        for program in self.programs.values():
            program.end()


@pytest.fixture
def engine(here: Path, services: dict[str, Any]) -> Iterator[Engine]:
    with machines(*services) as lab:
        engine = Engine(services, lab, here)
        try:
            yield engine
        finally:
            engine.end()


ASK = """
import sys, urllib.request as r
class Stay(r.HTTPRedirectHandler):
    def redirect_request(self, *_): return None
try:
    answer = r.build_opener(Stay).open(sys.argv[1])
    print(answer.status, len(answer.read()))
except r.HTTPError as error:
    print(error.status, error.headers["Location"])
"""


@pytest.mark.slow
def test_what_the_file_says_is_a_valid_run_equal_to_the_local_one(engine: Engine, here: Path) -> None:
    names = [name for name in engine.services if name != "orchestrator"]
    random.Random(7).shuffle(names)  # no order of starting is needed
    for name in names:
        engine.start(name)
    for name in ("plant", "agent-1", "agent-4"):
        until(lambda name=name: engine.is_healthy(name), f"{name}: {engine.said(name)}")  # type: ignore[misc]
    engine.start("orchestrator")
    until(lambda: "stays until Ctrl-C" in engine.said("orchestrator"), engine.said("orchestrator"))
    assert "watch it at http://localhost:9090" in engine.said("orchestrator")
    assert engine.is_healthy("orchestrator")

    def ask(target: str) -> str:  # from another machine
        words = [*engine.lab.on("router"), sys.executable, "-c", ASK, f"http://orchestrator:9090{target}"]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout

    page = "/?url=rerun%2Bhttp%3A%2F%2Forchestrator%3A9090%2Fproxy&theme=dark"
    assert ask("/") == f"302 {page}\n"
    assert ask(page).startswith("200 ")

    engine.programs["orchestrator"].process.send_signal(signal.SIGTERM)
    ended = {name: engine.programs[name].process.wait(DEADLINE_S) for name in engine.programs if name != "router"}
    assert set(ended.values()) == {0}, (ended, engine.said("orchestrator"))
    run = engine.folder / "orchestrator/runs/latest"
    verdict = json.loads((run / "verdict.json").read_text())
    assert verdict["verdict"] == "valid", verdict
    assert orchestrator("simulate", "paper7", "--run-dir", "local", "--no-record").returncode == 0
    assert parquet_bytes(here / "local") == parquet_bytes(run)


@pytest.mark.parametrize("words", [("paper7",), ("grid16", "--processes", "3")], ids=str)
def test_the_manifests_are_valid_by_the_schemas_of_kubernetes(here: Path, words: tuple[str, ...]) -> None:
    validator = pytest.importorskip("kubernetes_validate")
    done = orchestrator("compose", *words, "--format", "kubernetes")
    assert done.returncode == 0, done.stderr
    documents = list(yaml.safe_load_all(done.stdout))
    for document in documents:
        validator.validate(document, "1.33", strict=True)
    kinds = [document["kind"] for document in documents]
    shards = 3 if "--processes" in words else 7
    assert kinds.count("Job") == kinds.count("ConfigMap") == shards + 2
    assert kinds.count("Deployment") == 1
    for job in (document for document in documents if document["kind"] == "Job"):
        mounted = [one["configMap"]["name"] for one in job["spec"]["template"]["spec"]["volumes"] if "configMap" in one]
        assert mounted == [job["metadata"]["name"]], "a process is told its own and no more"


def test_what_is_too_large_for_an_environment_is_said(here: Path) -> None:
    Path("big.yaml").write_text(
        "name: big\nb: 0.1\nsteps: 3\nseed: 1\ndefaults: {candidates: {random: 5}, a: random}\n"
        f"nodes: {list(range(1000))}\nedges: {[[k, k + 1] for k in range(999)]}\n"
    )
    done = orchestrator("compose", "big.yaml", "--processes", "2")
    assert done.returncode == 2
    assert "a container at most 100000: use more --processes, or `orchestrator bundle`" in done.stderr
