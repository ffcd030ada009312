"""docker-compose.yml and the Kubernetes manifests: valid by their published schemas, and, the former, executed.

No container engine is needed: each service runs its command, with its environment, on a separate machine.
"""

from __future__ import annotations

import base64
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

from hedgerow.orchestrator.deploy.containers import containers, provide_keys
from hedgerow.orchestrator.ground.assignment import layout, places, views_of
from hedgerow.orchestrator.launch.certificates import to_carry
from hedgerow.topologies.errors import Code
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.tools.machines import ROOT, ROUTER, SECURE_ROUTER, Machines, Program, machines, scripts
from tests.tools.processes import DEADLINE_S, orchestrator, parquet_bytes
from tests.tools.refusals import refusal

FILE = ROOT / "docker-compose.yml"


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    found: dict[str, Any] = unescaped(yaml.safe_load(FILE.read_text()))["services"]
    return found


@pytest.fixture
def secure(here: Path) -> dict[str, Any]:
    """Return the output of `compose --secure`, in the folder of its keys."""
    done = orchestrator("compose", "paper7", "--secure", "--out", "secure.yml")
    assert done.returncode == 0, done.stderr
    assert (here / "secure.yml").stat().st_mode & 0o777 == 0o600
    found: dict[str, Any] = unescaped(yaml.safe_load(Path("secure.yml").read_text()))
    return found


def unescaped(value: Any) -> Any:
    """Return a value as an engine reads it: $$ is $, and a single $ would be a variable."""
    if isinstance(value, dict):
        return {key: unescaped(one) for key, one in value.items()}
    if isinstance(value, list):
        return [unescaped(one) for one in value]
    if isinstance(value, str):
        assert not re.search(r"(?<!\$)\$(?!\$)", value.replace("$$", "")), value
        return value.replace("$$", "$")
    return value


def test_the_file_in_the_repository_is_the_output_of_the_command() -> None:
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
    # The system's program, in its own Python: our packages must not interfere.
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


@pytest.mark.parametrize("form", ["compose", "kubernetes"])
def test_images_are_pulled_from_where_they_were_pushed(here: Path, form: str) -> None:
    made = orchestrator("compose", "paper7", "--format", form, "--registry", "registry.example/team/").stdout
    images = set(re.findall(r"image: (\S+)", made))
    pushed = {f"registry.example/team/{name}:{version('hedgerow')}" for name in ("hedgerow", "hedgerow-agent")}
    assert images == {*pushed, f"eclipse/zenoh:{version('eclipse-zenoh')}"}


def test_one_port_is_published_and_every_service_has_a_health_check(services: dict[str, Any]) -> None:
    assert [port for service in services.values() for port in service.get("ports", [])] == ["127.0.0.1:9090:9090"]
    for name, service in services.items():
        assert service["healthcheck"]["test"][0] == "CMD", name
        assert "sleep" not in json.dumps(service), name
    assert services["router"]["image"] == f"eclipse/zenoh:{version('eclipse-zenoh')}"


def test_no_agent_receives_the_data_of_another(services: dict[str, Any]) -> None:
    truth = yaml.safe_load(services["orchestrator"]["environment"]["HEDGEROW_TOPOLOGY"])["nodes"]
    for node in truth:
        config = services[f"agent-{node}"]["environment"]["HEDGEROW_CONFIG"]
        for other in truth:
            assert (other == node) == all(str(one) in config for one in truth[other]["candidates"])
        assert "disturbance" not in config


def test_a_secure_file_is_valid_and_its_services_have_their_own_keys(here: Path, secure: dict[str, Any]) -> None:
    vendor = resources.files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json"
    jsonschema.validate(secure, json.loads(vendor.read_text(encoding="utf-8")))
    seen: set[str] = set()
    for name, service in secure["services"].items():
        folders = {"orchestrator": {"observer", "operator"}}.get(name, {name})
        targets = [Path(one["target"]) for one in service["secrets"]]
        assert {target.parent.name for target in targets} == folders, name
        for one, target in zip(service["secrets"], targets, strict=True):
            file = here / secure["secrets"][one["source"]]["file"]
            assert file == here / target.relative_to("/"), "what is mounted is what its own folder has"
        assert service["user"] == f"{os.getuid()}:{os.getgid()}", "the readers of the secrets"
        seen |= {one["source"] for one in service["secrets"]}
    assert seen == secure["secrets"].keys()
    assert "PRIVATE KEY" not in Path("secure.yml").read_text()
    again = orchestrator("compose", "paper7", "--secure")
    assert again.stdout == Path("secure.yml").read_text(), "the same keys, used again"
    other = orchestrator("compose", "ring6", "--secure")
    assert other.returncode == 2
    assert other.stderr.startswith("error: --keys ")


def test_the_keys_lie_beside_the_file_that_names_them(here: Path) -> None:
    (here / "lab").mkdir()
    done = orchestrator("compose", "paper7", "--secure", "--out", "lab/secure.yml")
    assert done.returncode == 0, done.stderr
    files = [Path(one["file"]) for one in yaml.safe_load(Path("lab/secure.yml").read_text())["secrets"].values()]
    assert files
    assert all((here / "lab" / file).is_file() for file in files)


def test_keys_that_are_there_do_not_change_how_long_they_hold(here: Path) -> None:
    words = ("compose", "paper7", "--secure", "--days", "2")
    assert orchestrator(*words).returncode == 0
    again = orchestrator(*words)
    assert again.returncode == 2
    assert again.stderr == "error: --days 2: the keys in keys already exist; name a new folder, --keys DIR\n"


@pytest.mark.parametrize("words", ["keys {} --out", "bundle {} --secure --out", "compose {} --secure --keys"])
def test_a_place_that_cannot_hold_keys_is_named(here: Path, words: str) -> None:
    (here / "file").touch()
    done = orchestrator(*words.format("paper7").split(), "file/keys")
    assert done.returncode == 2
    assert done.stderr.startswith("error: file/keys: ")


@pytest.mark.parametrize(
    ("words", "largest"),
    [
        ("keys paper7 --out k", 1000),
        ("bundle paper7 --secure --out k", 1000),
        ("bundle paper7 --out k", 500),
        ("compose paper7 --secure --keys k", 1000),
        ("compose paper7 --out k", 10),
    ],
)
def test_a_full_disk_leaves_no_half_of_anything(here: Path, words: str, largest: int) -> None:
    done = orchestrator(*words.split(), largest=largest)
    assert done.returncode == 2
    assert re.fullmatch(r"error: (--out )?k: File too large; choose another (folder|name)\n", done.stderr)
    assert [*here.iterdir()] == []


def test_keys_that_are_interrupted_are_none_and_can_be_made_again(here: Path) -> None:
    def interrupted(_: Path) -> None:
        raise KeyboardInterrupt

    topology = resolve(load("paper7"))
    made = places(views_of(topology, layout(topology, 7)))
    for folder in (here / "new", here):
        with pytest.raises(KeyboardInterrupt):
            to_carry(folder, made, "hedgerow/x", "tls/bench:7447", 1, interrupted)
        assert [*here.iterdir()] == []
    names = to_carry(here, made, "hedgerow/x", "tls/bench:7447", 1)
    assert sorted(path.name for path in here.iterdir()) == sorted(names)


@pytest.mark.parametrize("command", ["keys", "bundle --secure"])
def test_a_host_that_no_certificate_can_name_is_refused_before_anything_is_written(here: Path, command: str) -> None:
    done = orchestrator(*command.split(), "paper7", "--out", "k", "--router", "tls/bänch:7447")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --router tls/bänch:7447: a certificate cannot name bänch; ")
    assert [*here.iterdir()] == []


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="there is no docker-compose")
def test_docker_compose_takes_a_secure_one(here: Path, secure: dict[str, Any]) -> None:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    words = ("docker-compose", "-f", "secure.yml", "config", "--quiet")
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def until(ready: Callable[[], bool], what: str) -> None:
    by = time.monotonic() + DEADLINE_S
    while not ready():
        assert time.monotonic() < by, what
        threading.Event().wait(0.05)


class Engine:
    """The runner of the services of a Compose file, each on a separate machine."""

    def __init__(self, file: dict[str, Any], lab: Machines, folder: Path) -> None:
        self.services: dict[str, Any] = {
            name: self._mounted(file, service, folder / name) for name, service in file["services"].items()
        }
        self.lab, self.folder = lab, folder
        path = f"{scripts(folder / 'bin')}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.environment = {"PATH": path, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(folder)}
        self.programs: dict[str, Program] = {}

    @staticmethod
    def _mounted(file: dict[str, Any], service: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Return the service with all of its mounts in a separate folder, where it finds them."""
        for volume in service.get("volumes", []):
            (folder / Path(volume.partition(":")[2]).name).mkdir(parents=True)
        for one in service.get("secrets", []):
            target = folder / one["target"].lstrip("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file["secrets"][one["source"]]["file"], target)
        return json.loads(re.sub(r"(?<![\w.])/keys\b", str(folder / "keys"), json.dumps(service)))  # type: ignore[no-any-return]

    def start(self, name: str) -> None:
        service = self.services[name]
        words = service["command"]
        if service["image"].startswith("eclipse/zenoh:"):
            listen = [word.partition("=")[2] for word in words if word.startswith("--listen=")]
            words = [sys.executable, "-c", *((ROUTER, *listen) if listen else (SECURE_ROUTER, *words))]
        environment = self.environment | service.get("environment", {})
        place = Path(service.get("working_dir", self.folder / name))
        self.programs[name] = Program(self.lab.on(name), words, place, environment)

    def is_healthy(self, name: str) -> bool:
        service = self.services[name]
        environment = {**os.environ, **self.environment, **service.get("environment", {})}
        words = [*self.lab.on(name), *service["healthcheck"]["test"][1:]]
        return subprocess.run(words, env=environment, capture_output=True, check=False).returncode == 0

    def output_of(self, name: str) -> str:
        return self.programs[name].log.read_text()

    def end(self) -> None:
        for program in self.programs.values():
            program.end()


@pytest.fixture(params=["open", "secure"])
def engine(here: Path, request: pytest.FixtureRequest) -> Iterator[Engine]:
    is_open = request.param == "open"
    file = unescaped(yaml.safe_load(FILE.read_text())) if is_open else request.getfixturevalue("secure")
    with machines(*file["services"]) as lab:
        engine = Engine(file, lab, here)
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
def test_the_file_makes_a_valid_run_equal_to_the_local_one(engine: Engine, here: Path) -> None:
    names = [name for name in engine.services if name != "orchestrator"]
    random.Random(7).shuffle(names)  # no order of starting is needed
    for name in names:
        engine.start(name)
    for name in ("plant", "agent-1", "agent-4"):
        until(lambda name=name: engine.is_healthy(name), f"{name}: {engine.output_of(name)}")  # type: ignore[misc]
    engine.start("orchestrator")
    until(lambda: "stays until Ctrl-C" in engine.output_of("orchestrator"), engine.output_of("orchestrator"))
    assert "http://localhost:9090" in engine.output_of("orchestrator")
    assert engine.is_healthy("orchestrator")

    def ask(target: str) -> str:  # from another machine
        words = [*engine.lab.on("router"), sys.executable, "-c", ASK, f"http://orchestrator:9090{target}"]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout

    page = "/?url=rerun%2Bhttp%3A%2F%2Forchestrator%3A9090%2Fproxy&theme=dark"
    assert ask("/") == f"302 {page}\n"
    assert ask(page).startswith("200 ")

    engine.programs["orchestrator"].process.send_signal(signal.SIGTERM)
    ended = {name: engine.programs[name].process.wait(DEADLINE_S) for name in engine.programs if name != "router"}
    assert set(ended.values()) == {0}, (ended, engine.output_of("orchestrator"))
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
        assert mounted == [job["metadata"]["name"]], "a process receives only its own data"


def test_secure_manifests_are_valid_and_each_process_has_its_secret(here: Path) -> None:
    validator = pytest.importorskip("kubernetes_validate")
    words = ("compose", "paper7", "--secure", "--format", "kubernetes")
    printed = orchestrator(*words)
    assert printed.returncode == 2
    assert "--out FILE" in printed.stderr
    done = orchestrator(*words, "--out", "network.yaml")
    assert done.returncode == 0, done.stderr
    assert (here / "network.yaml").stat().st_mode & 0o777 == 0o600
    documents = list(yaml.safe_load_all(Path("network.yaml").read_text()))
    held = {}
    for document in documents:
        validator.validate(document, "1.33", strict=True)
        if document["kind"] == "Secret":
            name = document["metadata"]["name"]
            held[name] = {file: base64.b64decode(text) for file, text in document["data"].items()}
            assert all((here / "keys" / name / file).read_bytes() == text for file, text in held[name].items())
    assert held.keys() == {path.name for path in (here / "keys").iterdir()}
    assert len({files["key.pem"] for files in held.values()}) == len(held)
    for document in documents:
        if document["kind"] not in ("Job", "Deployment"):
            continue
        name, spec = document["metadata"]["name"], document["spec"]["template"]["spec"]
        volumes = {one["name"]: one["secret"] for one in spec["volumes"] if "secret" in one}
        own = ["observer", "operator"] if name == "orchestrator" else [name]
        assert [one["secretName"] for one in volumes.values()] == own
        assert {one["defaultMode"] for one in volumes.values()} == {0o440}
        mounts = [one for one in spec["containers"][0]["volumeMounts"] if one["name"] in volumes]
        assert [one["mountPath"] for one in mounts] == [f"/keys/{one}" for one in own]
        assert all(one["readOnly"] for one in mounts)
    config = next(one for one in documents if one["kind"] == "ConfigMap" and one["metadata"]["name"] == "agent-3")
    assert 'credentials = "/keys/agent-3"' in config["data"]["config.toml"]
    assert not any(b"PRIVATE KEY" in yaml.dump(one).encode() for one in documents if one["kind"] != "Secret")


def test_a_config_too_large_for_an_environment_is_refused(here: Path) -> None:
    Path("big.yaml").write_text(
        "name: big\nb: 0.1\nsteps: 3\nseed: 1\ndefaults: {candidates: {random: 5}, a: random}\n"
        f"nodes: {list(range(1000))}\nedges: {[[k, k + 1] for k in range(999)]}\n"
    )
    done = orchestrator("compose", "big.yaml", "--processes", "2")
    assert done.returncode == 2
    assert done.stderr.startswith("error: big: ")
    assert "--processes" in done.stderr


def test_rules_too_large_for_a_secret_are_refused(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    topology = resolve(load("paper7"), Path())
    shards = layout(topology, None)
    provide_keys(Path("keys"), places(views_of(topology, shards)), "here", 1)
    monkeypatch.setattr("hedgerow.orchestrator.deploy.containers.MOST_SECRET_BYTES", 10_000)
    with refusal(Code.TOPOLOGY, "paper7"):
        containers(topology, shards, "here", 10, 100_000, Path("keys"))
