"""Secure runs: only the messages of the information structure, the same numbers, and no remaining keys."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import psutil
import pytest
from cryptography import x509

from hedgerow.orchestrator.launch.certificates import LIFE_DAYS, SLACK
from hedgerow.wire.ports import free_port
from tests.tools.processes import COMMAND, QUIET, Orchestrator, gone, orchestrator, run_here
from tests.tools.verdicts import verdict_of

ROUTER = """
import signal, zenoh
with zenoh.open(zenoh.Config.from_file("zenohd.json5")):
    print("open", flush=True)
    signal.pause()
"""


def secrets(here: Path) -> list[Path]:
    """Everything of any run's credentials."""
    return [*(here / f"hedgerow-{os.getuid()}").glob("*.keys/**/*")]


def contents(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())


def test_a_secure_run_gives_the_same_bits_through_a_crash(here: Path) -> None:
    """The reference knows no security: equal to it is equal to the open run. A restarted agent may connect again."""
    crash = "faults=[{kind: crash, node: 3, at: 8, restart_after: 5}, {kind: drop, link: [2, 4], steps: [0, 12]}]"
    done = orchestrator("up", "paper7", "--secure", "--verify", "--set", crash, *QUIET)
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = verdict_of(here / "runs/latest")
    assert verdict["checks"]["reference"]["ok"]
    assert verdict["checks"]["information"]["ok"]
    assert verdict["restarts"] == 1
    assert "secure: true" in (here / "runs/latest/topology.yaml").read_text()


def test_every_process_received_exactly_its_messages(here: Path) -> None:
    done = orchestrator("up", "paper7", *QUIET)
    assert done.returncode == 0, done.stderr
    information = verdict_of(here / "runs/latest")["information"]
    assert (information["strange"], information["silent"]) == ({}, [])
    channels = information["channels"]
    assert len(channels) == 7 + 7 + 2 * 6
    assert all(one["received"] == one["sent"] for one in channels if one["receiver"] == "plant")
    assert all(30 <= one["received"] <= one["sent"] <= 31 for one in channels if one["key"].startswith("link/"))
    shown = json.loads(orchestrator("audit", "paper7", "--json").stdout)["channels"]
    assert [(one["key"], one["from"], one["to"]) for one in shown] == [
        (one["key"], one["sender"], one["receiver"]) for one in channels
    ]


def test_repeated_messages_pass_a_router_with_a_rate_limit(here: Path) -> None:
    """While one agent is frozen, the others repeat their messages with every state that the plant repeats."""
    with Orchestrator("up", "paper7", "--secure", "--steps", "200", "--rate", "200", *QUIET) as network:
        network.wait_for("running")
        os.kill(network.children["agent-3"], signal.SIGSTOP)
        network.wait_for_log("plant", "repeated, still without shards", 4)
        os.kill(network.children["agent-3"], signal.SIGCONT)
        assert network.wait() == 0, network.output
    everything = verdict_of(here / "runs/latest")["information"]["channels"]
    channels = [one for one in everything if one["sender"] not in ("plant", "agent-3")]
    assert all(one["received"] >= one["sent"] - 1 for one in channels), channels
    assert min(one["sent"] for one in channels) >= 200


@pytest.fixture
def network(here: Path) -> Iterator[Orchestrator]:
    """A secure paper7 running for ever."""
    with Orchestrator("up", "paper7", "--secure", "--steps", "1000000", "--rate", "200", *QUIET) as network:
        network.wait_for("running")
        yield network


def test_keys_are_their_users_alone_short_lived_and_in_no_log(here: Path, network: Orchestrator) -> None:
    found = secrets(here)
    files = [path for path in found if path.is_file()]
    assert {path.parent.name for path in files} == {
        "router",
        "observer",
        "operator",
        *(f"agent-{i}" for i in range(1, 8)),
    }
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    assert {path.stat().st_mode & 0o777 for path in {*found} - {*files}} == {0o700}
    now = datetime.now(UTC)
    for path in files:
        if path.name == "cert.pem":
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
            assert certificate.subject.rfc4514_string() == f"CN={path.parent.name}"
            assert timedelta() < now - certificate.not_valid_before_utc - SLACK < timedelta(minutes=2)
            assert certificate.not_valid_after_utc - now < timedelta(days=LIFE_DAYS)
    printed = contents(here / "runs") + network.output.encode()
    assert b"PRIVATE KEY" not in printed
    assert not any(path.read_text().splitlines()[1].encode() in printed for path in files if path.name == "key.pem")
    # The operator has separate keys.
    assert orchestrator("status").returncode == 0
    assert orchestrator("fault", "drop", "2-4", "--for", "5").returncode == 0
    assert orchestrator("stop").returncode == 0
    assert network.wait() == 3
    assert secrets(here) == []


def test_a_killed_up_leaves_no_key(here: Path, network: Orchestrator) -> None:
    children = network.children
    fork_client = psutil.Process(children["plant"]).ppid()
    network.send(signal.SIGKILL)
    assert gone({**children, "fork server": fork_client})
    assert secrets(here) == []
    assert [*(here / f"hedgerow-{os.getuid()}").iterdir()] == []


def test_a_fork_server_that_outlives_its_children_leaves_no_key(here: Path, network: Orchestrator) -> None:
    """The server wakes up after its client has gone, and cannot report the deaths."""
    children = network.children
    fork_client = psutil.Process(children["plant"]).ppid()
    os.kill(fork_client, signal.SIGSTOP)
    network.send(signal.SIGKILL)
    network.wait()
    assert psutil.wait_procs([psutil.Process(pid) for pid in children.values()], 0)[1]  # it reaps them
    os.kill(fork_client, signal.SIGCONT)
    assert gone({**children, "fork server": fork_client})
    assert secrets(here) == []


def test_a_look_for_networks_removes_the_keys_of_dead_ones(here: Path, network: Orchestrator) -> None:
    """`up`, its fork server and the plant are killed at once: no process of the run can remove the keys."""
    assert gone(network.kill_all_who_could_clean_up())
    assert secrets(here) != []
    assert orchestrator("ps").stdout == "no network is running\n"
    assert secrets(here) == []


def test_a_separate_router_has_the_same_rules(here: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    made = orchestrator("keys", "paper7", "--router", endpoint, "--out", "keys")
    assert made.returncode == 0, made.stderr
    assert {path.name for path in (here / "keys").iterdir()} == {
        "plant", "observer", "operator", "router", *(f"agent-{i}" for i in range(1, 8))
    }  # fmt: skip
    command = [sys.executable, "-c", ROUTER]
    with subprocess.Popen(command, cwd=here / "keys/router", stdout=subprocess.PIPE, text=True) as router:
        try:
            assert router.stdout is not None
            assert router.stdout.readline() == "open\n"
            done = orchestrator("up", "paper7", "--secure", "--keys", "keys", "--verify", *QUIET)
            assert done.returncode == 0, done.stdout + done.stderr
            assert verdict_of(here / "runs/latest")["information"]["silent"] == []
            assert "chmod" not in done.stderr
            (here / "keys/observer/key.pem").chmod(0o644)
            with Orchestrator("up", "paper7", "--secure", "--keys", "keys", "--steps", "100000", *QUIET) as network:
                network.wait_for("running")
                assert orchestrator("stop").returncode == 0
                assert network.wait() == 3
            assert "keys/observer/key.pem: " in network.output
        finally:
            router.kill()
    assert (here / "keys/agent-1/key.pem").exists()  # these belong to their creator
    other = orchestrator("up", "ring6", "--secure", "--keys", "keys", *QUIET)
    assert other.returncode == 2
    assert other.stderr.startswith("error: --keys keys: ")


def test_the_command_that_uses_keys_can_be_copied(here: Path) -> None:
    made = orchestrator("keys", "paper7", "--out", "our keys", "--processes", "2")
    assert made.stdout.endswith("then: orchestrator up paper7 --secure --keys 'our keys' --processes 2\n")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--secure", "--router", "tcp/127.0.0.1:7447"), "tls/HOST:PORT"),
        (("--secure", "--router", "tls/127.0.0.1:7447"), "--keys"),
        (("--secure", "--keys", "nowhere"), "--keys nowhere: "),
        (("--keys", "nowhere"), "--secure"),
    ],
)
def test_an_insecure_combination_is_refused_before_anything_runs(
    here: Path, options: tuple[str, ...], named: str
) -> None:
    done = run_here("up", "paper7", *options, *QUIET)
    assert done.returncode == 2
    assert named in done.stderr
    assert not (here / "runs").exists()


def test_a_missing_library_is_named(here: Path) -> None:
    (here / "without").mkdir()
    (here / "without/cryptography.py").write_text("raise ImportError('not installed')")
    path = os.pathsep.join([str(here / "without"), *sys.path])
    done = subprocess.run(
        [*COMMAND, "up", "paper7", "--secure", *QUIET],
        capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == ("error: --secure: needs cryptography. Install it with: pip install cryptography\n")


def test_a_folder_of_another_user_is_not_trusted(here: Path) -> None:
    (here / f"hedgerow-{os.getuid()}").mkdir(mode=0o777)
    (here / f"hedgerow-{os.getuid()}").chmod(0o777)
    done = orchestrator("up", "paper7", "--secure", *QUIET)
    assert done.returncode == 2
    assert f"hedgerow-{os.getuid()}" in done.stderr
