"""Real faults: a link between two hosts that loses packets, goes down and comes back, and a router that dies and
returns. The hosts are network namespaces, which need root; the router runs in one, the network in the other.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hedgerow.wire.session import LEASE_S
from tests.tools.machines import ROUTER, command
from tests.tools.processes import Orchestrator, gone, orchestrator, parquet_bytes

pytestmark = pytest.mark.slow

RUN = ("--viewer", "none", "--no-record", "--verify")


class Lab:
    """Two hosts, a link between them, and a router on the first."""

    def __init__(self, name: str) -> None:
        self.hosts = (f"{name}r", f"{name}c")
        self.endpoint = "tcp/10.77.0.1:7447"
        self._router: subprocess.Popen[str] | None = None

    def build(self) -> None:
        """Make both hosts and the link; skip the test where that cannot be."""
        if os.geteuid() != 0:
            pytest.skip("network namespaces need root")
        router, client = self.hosts
        for host in self.hosts:
            command("ip", "netns", "add", host)
        command("ip", "link", "add", "wire", "netns", router, "type", "veth", "peer", "name", "wire", "netns", client)
        for number, host in enumerate(self.hosts, 1):
            command("ip", "-n", host, "addr", "add", f"10.77.0.{number}/24", "dev", "wire")
            command("ip", "-n", host, "link", "set", "lo", "up")
            command("ip", "-n", host, "link", "set", "wire", "up")
            # TCP waits 200 ms before it repeats a packet; on a link of a few microseconds 10 are plenty.
            route = ("10.77.0.0/24", "dev", "wire", "src", f"10.77.0.{number}", "rto_min", "10ms")
            command("ip", "-n", host, "route", "change", *route)

    def lose(self, one_of: int) -> None:
        """Drop every Nth received packet, at both ends.

        The loss is regular and starts after the connection. TCP doubles its wait with each loss in a row, and waits 3 s
        after a loss in its handshake. Random losses would cause, sooner or later, a silence longer than any deadline.
        """
        drop = f"numgen inc mod {one_of} == 0 drop"
        chain = f'chain in {{ type filter hook ingress device "wire" priority 0; {drop}; }}'
        for host in self.hosts:
            command("ip", "netns", "exec", host, "nft", f"table netdev faults {{ {chain}; }}")

    def link(self, state: str) -> None:
        """Set the link `down` or `up`."""
        command("ip", "-n", self.hosts[1], "link", "set", "wire", state)

    def start_router(self, lease_s: float = LEASE_S) -> None:
        """A router on the first host; it listens when this returns.

        Its clients count it as gone after a silence of `lease_s`. A router of the user has its own lease too.
        """
        inside = ("ip", "netns", "exec", self.hosts[0])
        leased = f"from hedgerow.wire import session\nsession.LEASE_S = {lease_s}\n"
        program = (sys.executable, "-c", leased + ROUTER, self.endpoint)
        self._router = subprocess.Popen((*inside, *program), stdout=subprocess.PIPE, text=True)
        assert self._router.stdout is not None
        assert self._router.stdout.readline() == "open\n"

    def kill_router(self) -> None:
        """SIGKILL."""
        if self._router is not None:
            self._router.kill()
            self._router.wait()
            assert self._router.stdout is not None
            self._router.stdout.close()
            self._router = None

    def up(self, *arguments: str) -> Orchestrator:
        """`orchestrator up paper7` on the second host; the router runs, or starts now."""
        if self._router is None:
            self.start_router()
        inside = ("ip", "netns", "exec", self.hosts[1])
        return Orchestrator("up", "paper7", *RUN, "--router", self.endpoint, *arguments, inside=inside)

    def tear_down(self) -> None:
        """Remove everything."""
        self.kill_router()
        for host in self.hosts:
            with contextlib.suppress(FileNotFoundError):
                subprocess.run(("ip", "netns", "del", host), capture_output=True, check=False)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    lab = Lab(f"hedgerow{os.getpid()}")
    try:
        lab.build()
        yield lab
    finally:
        lab.tear_down()


def complete(folder: Path) -> dict[str, Any]:
    """The verdict of a run that must be valid, with every row of telemetry, equal to the reference."""
    verdict: dict[str, Any] = json.loads((folder / "verdict.json").read_text())
    assert verdict["verdict"] == "valid", verdict["reasons"]
    assert verdict["lost_rows"] == 0
    assert verdict["checks"]["reference"]["ok"]
    return verdict


def test_a_link_that_loses_a_fifth_of_all_packets_costs_only_time(lab: Lab) -> None:
    with lab.up("--steps", "50", "--rate", "50", "--deadline", "60") as network:
        network.wait_for("running")
        lab.lose(one_of=5)
        assert network.wait() == 0, network.output
        print(network.output)  # `pytest -rP` shows the effect on the answer times
        assert gone(network.children)
    assert complete(Path("runs/latest"))["missing_inputs"] == 0


def test_a_link_that_goes_down_and_comes_back(lab: Lab) -> None:
    with lab.up("--steps", "600", "--rate", "200") as network:
        network.wait_for("running")
        lab.link("down")
        network.wait_for_log("plant", "repeated, still without shards", 2)
        lab.link("up")
        assert network.wait() == 0, network.output
    assert complete(Path("runs/latest"))["missing_inputs"] == 0


def test_a_router_that_dies_and_returns(lab: Lab) -> None:
    with lab.up("--steps", "600", "--rate", "200") as network:
        network.wait_for("running")
        lab.kill_router()
        network.wait_for_log("plant", "repeated, still without shards", 2)
        lab.start_router()
        assert network.wait() == 0, network.output
    assert complete(Path("runs/latest"))["missing_inputs"] == 0


def test_a_link_that_stays_down_ends_the_run_with_names_and_recorded_steps(lab: Lab) -> None:
    lab.start_router(lease_s=4.0)
    with lab.up("--steps", "100000", "--rate", "200", "--deadline", "2") as network:
        network.wait_for("running")
        lab.link("down")
        assert network.wait() == 3, network.output
        # One of these notices first: the plant without inputs, or `up` without a router.
        named = ("no input from agent ", "the router at tcp/10.77.0.1:7447 is gone")
        assert any(cause in network.output for cause in named), network.output
        assert gone(network.children)
    steps = json.loads(Path("runs/latest/verdict.json").read_text())["steps_done"]
    assert steps > 0
    assert Path("runs/latest/telemetry.parquet").exists()


def test_a_frozen_agent_on_the_other_side_of_a_lossy_link_is_taken_back(lab: Lab) -> None:
    with lab.up("--steps", "500", "--rate", "200", "--deadline", "1") as network:
        network.wait_for("running")
        lab.lose(one_of=50)
        os.kill(network.children["agent-4"], signal.SIGSTOP)
        network.wait_for("going on without agent 4")
        os.kill(network.children["agent-4"], signal.SIGCONT)
        network.wait_for("agent 4 is back")
        assert network.wait() == 0, network.output
    complete(Path("runs/latest"))
    done = orchestrator("simulate", "runs/latest", "--run-dir", "again", "--no-record")
    assert done.returncode == 0, done.stdout
    assert parquet_bytes(Path("again")) == parquet_bytes(Path("runs/latest"))
