"""Secure separate processes: their files, the permitted connections, and the messages about refusals."""

from __future__ import annotations

import json
import shutil
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml
from cryptography import x509

from hedgerow.orchestrator.launch.certificates import Authority, to_carry
from hedgerow.topologies.errors import Code, Exit
from hedgerow.wire.access import access_control
from hedgerow.wire.credentials import CA, CERTIFICATE, PRIVATE_KEY
from hedgerow.wire.handshake import room
from hedgerow.wire.ports import free_port
from hedgerow.wire.refusal import refused
from hedgerow.wire.session import close, open_client, open_router
from hedgerow.wire.standalone import wait_for
from tests.orchestrator.launch.test_secure import ROUTER
from tests.tools.machines import Program
from tests.tools.processes import DEADLINE_S, Orchestrator, orchestrator, parquet_bytes, run_here
from tests.tools.refusals import refusal
from tests.tools.rights import PLACES
from tests.tools.standalone import UP, start
from tests.tools.verdicts import verdict_of

__all__ = ["start"]


@pytest.fixture
def port(here: Path) -> int:
    return free_port()


def bundle(port: int, *arguments: str) -> None:
    made = ("bundle", "paper7", "--secure", "--out", "lab", "--router", f"tls/localhost:{port}", *arguments)
    done = orchestrator(*made)
    assert done.returncode == 0, done.stderr


def up(port: int, *arguments: str) -> Orchestrator:
    """Return a run with a plant that opens that port."""
    listen = ("--listen", f"tls/0.0.0.0:{port}", "--keys", "lab")
    return Orchestrator("up", "lab/topology.yaml", *listen, *UP, *arguments)


def test_every_folder_has_only_its_own_keys(here: Path, port: int) -> None:
    bundle(port, "--days", "2")
    folders = {path.name: path for path in Path("lab").iterdir() if path.is_dir()}
    agents = {f"agent-{name}" for name in range(1, 8)}
    assert folders.keys() == {"plant", "observer", "operator", "router", *agents}
    secrets = {name: (folder / PRIVATE_KEY).read_text() for name, folder in folders.items()}
    assert len(set(secrets.values())) == len(folders)
    truth = yaml.safe_load(Path("lab/topology.yaml").read_text())["nodes"]
    for name, folder in folders.items():
        assert folder.stat().st_mode & 0o777 == 0o700
        files = [*folder.iterdir()]
        assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
        printed = "".join(path.read_text() for path in files)
        assert [one for one, secret in secrets.items() if secret.splitlines()[1] in printed] == [name]
        if name in agents:
            known = {f"agent-{node}" for node in truth if all(str(a) in printed for a in truth[node]["candidates"])}
            assert known == {name}
        certificate = x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
        assert certificate.subject.rfc4514_string() == f"CN={name}"
        assert certificate.not_valid_after_utc - certificate.not_valid_before_utc < timedelta(days=2, hours=1)
    assert "PRIVATE KEY" not in (Path("lab/README.md").read_text() + Path("lab/topology.yaml").read_text())
    again = orchestrator("bundle", "paper7", "--secure", "--out", "lab", "--router", f"tls/localhost:{port}")
    assert again.returncode == 2
    assert again.stderr.startswith("error: lab: ")


def test_separate_agents_join_with_their_keys_and_change_nothing(here: Path, port: int, start: Any) -> None:
    """One receives its folder, one finds it by its name, one gets the path of its keys; all end with the run."""
    bundle(port)
    shutil.copytree("lab/agent-6", "keys-of-6")
    (here / "lab/agent-6/key.pem").unlink()
    configs: list[tuple[str, ...]] = [("--config", "lab/agent-3"), ("--config", "lab/agent-5.toml")]
    configs.append(("--config", "lab/agent-6/config.toml", "--credentials", "keys-of-6"))
    agents = [start("agents", *words) for words in configs]
    with up(port, "--external", "3,5,6") as network:
        assert network.wait() == 0, network.output
        assert network.children.keys() == {"plant", *(f"agent-{name}" for name in (1, 2, 4, 7))}
    assert verdict_of()["checks"]["reference"]["ok"]
    assert verdict_of()["checks"]["information"]["ok"]
    assert [agent.wait()[0] for agent in agents] == [0, 0, 0]
    assert (here / "lab/agent-3/key.pem").exists()  # these belong to their creator


def test_separate_processes_over_a_router_with_its_rules(here: Path, port: int, start: Any) -> None:
    bundle(port, "--processes", "2", "--steps", "20")
    router = Program((), (sys.executable, "-c", ROUTER), Path("lab/router").absolute())
    try:
        with Orchestrator("up", "lab/topology.yaml", "--external", "plant,all", "--keys", "lab", *UP) as network:
            network.wait_for("waiting for plant, shard-0, shard-1")
            others = [start("plant", "--config", "lab/plant")]
            others += [start("agents", "--config", f"lab/shard-{p}") for p in (0, 1)]
            assert network.wait() == 0, network.output
        assert [one.wait()[0] for one in others] == [0, 0, 0]
    finally:
        router.end()
    assert orchestrator("simulate", "lab/topology.yaml", "--run-dir", "here", "--no-record").returncode == 0
    assert parquet_bytes(Path("here")) == parquet_bytes(Path("runs/latest"))


def test_plant_and_observer_may_see_the_token_of_a_plant(here: Path, port: int, start: Any) -> None:
    bundle(port)
    router = Program((), (sys.executable, "-c", ROUTER), Path("lab/router").absolute())
    try:
        first = start("plant", "--config", "lab/plant")
        with open_client(f"tls/localhost:{port}", "hedgerow/paper7", Path("lab/observer"), DEADLINE_S) as session:
            wait_for(session, "plant", DEADLINE_S)
            configs: list[str] = []
            with room(session, "hedgerow/paper7", configs.append, lambda: bool(configs)):
                assert configs
        start("plant", "--config", "lab/plant").wait_for("another plant already runs at hedgerow/paper7")
        assert first.poll() is None
    finally:
        router.end()


def test_a_plant_elsewhere_is_the_router_with_the_routers_keys(here: Path, port: int, start: Any) -> None:
    bundle(port, "--processes", "2", "--steps", "20")
    listen = ("--listen", f"tls/127.0.0.1:{port}")
    code, printed = start("plant", "--config", "lab/plant", *listen).wait()
    assert code == 3
    assert "--credentials" in printed
    plant = start("plant", "--config", "lab/plant", *listen, "--credentials", "lab/router")
    agents = [start("agents", "--config", f"lab/shard-{p}") for p in (0, 1)]
    with Orchestrator("up", "lab/topology.yaml", "--external", "plant,all", "--keys", "lab", *UP) as network:
        assert network.wait() == 0, network.output
    assert [one.wait()[0] for one in (plant, *agents)] == [0, 0, 0]
    assert verdict_of()["checks"]["reference"]["ok"]


def in_place_of_agent_3(folder: str, other: str, *files: str) -> None:
    """Its folder, with files from another."""
    shutil.copytree("lab/agent-3", folder)
    for file in files:
        shutil.copy(f"{other}/{file}", folder)


def test_wrong_keys_are_reported_at_both_ends(here: Path, port: int, start: Any) -> None:
    """Keys of another authority, and those of another agent: each gives one line, soon, and no traceback."""
    bundle(port, "--steps", "20")
    Authority().issue(Path("issued"), "agent-3")
    in_place_of_agent_3("foreign", "issued", CERTIFICATE, PRIVATE_KEY)  # the router refuses it
    in_place_of_agent_3("distrusting", "issued", CA)  # it refuses the router
    in_place_of_agent_3("swapped", "lab/agent-5", CERTIFICATE, PRIVATE_KEY)
    printed = {}
    with up(port, "--external", "3") as network:
        network.wait_for("waiting for agent-3")
        wrong = {name: start("agents", "--config", name) for name in ("foreign", "distrusting", "swapped")}
        wrong["open"] = start("agents", "--config", "lab/agent-3", "--router", f"tcp/localhost:{port}")
        for name, agent in wrong.items():
            code, printed[name] = agent.wait()
            assert code in (Exit.USER_MISTAKE, Exit.UNKNOWN), printed[name]
            assert "Traceback" not in printed[name]
        network.wait_for("our router refused a certificate: it is of another authority")
        network.wait_for("a client refused our certificate: it is of another authority")
        right = start("agents", "--config", "lab/agent-3")
        assert network.wait() == 0, network.output
        assert right.wait()[0] == 0
    refuses = f"the router at tls/localhost:{port} refuses the certificate in foreign: it is of another authority"
    assert refuses in printed["foreign"]
    assert f"tls/localhost:{port}" in printed["distrusting"]
    assert "agent-3" in printed["swapped"]
    assert f"tcp/localhost:{port}" in printed["open"]


def test_an_observer_with_wrong_keys_does_not_wait(here: Path, port: int) -> None:
    for folder in ("lab", "other"):
        to_carry(Path(folder), PLACES, "hedgerow/paper7", f"tls/localhost:{port}", days=1)
    router = open_router(f"tls/127.0.0.1:{port}", "hedgerow/paper7", Path("other/router"))
    try:
        up = ("up", "paper7", "--secure", "--keys", "lab", "--external", "plant,all", "--wait", "600", *UP)
        with Orchestrator(*up) as network:
            assert network.wait() == 3, network.output
    finally:
        close(router)
    assert f"the router at tls/localhost:{port}: " in network.output


@pytest.mark.parametrize(
    "rules",
    [
        *("{}", "[1]", "3", '{"access_control": null}', '{"access_control": {"enabled": false}}'),
        '{"access_control": {"enabled": true, "default_permission": "allow"}}',
    ],
)
def test_a_router_without_rules_does_not_open(here: Path, rules: str) -> None:
    Authority().issue(Path("router"), "router", host="localhost")
    Path("router/access.json").write_text(rules)
    with refusal(Code.FILE_FORMAT, "router/access.json"):
        open_router(f"tls/127.0.0.1:{free_port()}", "here", Path("router"))


def test_expired_keys_are_reported_at_both_ends(here: Path, port: int, capfd: pytest.CaptureFixture[str]) -> None:
    authority = Authority()
    authority.issue(Path("router"), "router", host="localhost")
    Path("router/access.json").write_text(json.dumps({"access_control": access_control({}, "here")}))
    authority.until = datetime.now(UTC) - timedelta(minutes=1)
    authority.issue(Path("agent-3"), "agent-3")
    router = open_router(f"tls/127.0.0.1:{port}", "here", Path("router"))
    try:
        with refusal(Code.REFUSED):
            open_client(f"tls/localhost:{port}", "here", Path("agent-3"))
    finally:
        close(router)
    logged = "".join(capfd.readouterr())
    assert "our router refused a certificate: it has expired" in map(refused, logged.splitlines())


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("paper7", "--secure", "--listen", "tls/0.0.0.0:1"), "`orchestrator bundle FILE --secure --router"),
        (("lab/topology.yaml", "--listen", "tcp/0.0.0.0:1", "--keys", "lab"), "--listen tcp/0.0.0.0:1: "),
        (("lab/topology.yaml", "--keys", "lab", "--namespace", "x"), "hedgerow/paper7"),
        (("lab/topology.yaml", "--keys", "old"), "--keys old: "),
        (("ring6", "--secure", "--keys", "lab"), "--keys lab: "),
    ],
)
def test_impossible_options_are_refused_at_once(here: Path, arguments: tuple[str, ...], named: str) -> None:
    if "old" in arguments:
        to_carry(Path("old"), PLACES, "hedgerow/paper7", "tls/localhost:1", days=-0.001)
    bundle(1)
    done = run_here("up", *arguments, "--external", "3", *UP)
    assert done.returncode == 2, done.stdout + done.stderr
    assert named in done.stderr
    assert not (here / "runs").exists()


def test_without_keys_no_process_may_join(here: Path, start: Any) -> None:
    bundle(1)
    configs = Path("lab/agent-3/config.toml")
    configs.write_text(configs.read_text().replace('credentials = "."\n', ""))
    code, printed = start("agents", "--config", "lab/agent-3").wait()
    assert code == 2
    assert "--credentials" in printed
