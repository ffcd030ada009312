"""A network over four machines: the router on one, agents on two, the plant and the observer on the fourth."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.tools.machines import ROUTER, SECURE_ROUTER, Machines, Program, machines
from tests.tools.processes import Orchestrator, orchestrator, parquet_bytes
from tests.tools.verdicts import verdict_of

pytestmark = pytest.mark.slow
LEFT, RIGHT = (1, 2, 3), (4, 5, 6, 7)
AGENT = (sys.executable, "-P", "-c", "from hedgerow.agents.standalone import main; main()")


MACHINES = ("router", "left", "right", "bench")


@pytest.fixture
def lab(here: Path) -> Iterator[Machines]:
    with machines(*MACHINES) as lab:
        yield lab


@pytest.fixture
def ordinary(here: Path) -> Iterator[Machines]:
    """The same machines, with TCP as it is everywhere."""
    with machines(*MACHINES, rto_min=None) as lab:
        yield lab


class Network:
    """paper7 over the machines, open or secure."""

    def __init__(self, lab: Machines, steps: int, *options: str, secure: bool = False) -> None:
        self._lab = lab
        endpoint = "tls/router:7447" if secure else "tcp/router:7447"
        common = ("paper7", "--steps", str(steps), "--router", endpoint)
        done = orchestrator("bundle", *common, *(["--secure"] if secure else []), "--out", "lab")
        assert done.returncode == 0, done.stderr
        router = (SECURE_ROUTER, "--config=zenohd.json5") if secure else (ROUTER, "tcp/0.0.0.0:7447")
        words = (sys.executable, "-c", *router)
        self._programs = [Program(lab.on("router"), words, carry("router" if secure else "", "router"))]
        for machine, names in (("left", LEFT), ("right", RIGHT)):
            for name in names:
                own = f"agent-{name}" if secure else f"agent-{name}.toml"
                folder = carry(own, machine)
                self._programs.append(Program(lab.on(machine), (*AGENT, "--name", str(name)), folder))
        keys = ("--keys", "lab") if secure else ()
        self.up = Orchestrator(
            *("up", "lab/topology.yaml", "--router", endpoint, "--namespace", "hedgerow/paper7", *keys),
            *("--external", "all", "--viewer", "none", "--no-record", "--verify", *options),
            inside=lab.on("bench"),
        )

    def __enter__(self) -> Orchestrator:
        return self.up

    def __exit__(self, *_: object) -> None:
        self.up.__exit__(None, None, None)
        for program in self._programs:
            program.end()


def carry(what: str, machine: str) -> Path:
    """Move a file or a folder of the bundle to a machine: where it then lies, and a program's log."""
    folder = Path.cwd() / f"{machine}-{what.removesuffix('.toml')}"
    if what == "router":
        return Path(shutil.move("lab/router", folder))
    folder.mkdir()
    if what:
        shutil.move(f"lab/{what}", folder)
    return folder


def test_a_secure_network_loses_only_time_when_a_cable_is_unplugged_for_five_seconds(ordinary: Machines) -> None:
    """The deadline is longer than the default: if this test reconnects the cable late, TCP also retries later."""
    with Network(ordinary, 300, "--rate", "100", "--deadline", "20", secure=True) as network:
        network.wait_for("running")
        ordinary.cable("left", "down")
        pulled_at = time.monotonic()
        network.wait_for_log("plant", "repeated, still without shards", 12)  # every 0.5 s
        assert time.monotonic() - pulled_at > 5
        ordinary.cable("left", "up")
        assert network.wait() == 0, network.output
    assert verdict_of()["verdict"] == "valid"
    assert verdict_of()["missing_inputs"] == verdict_of()["lost_rows"] == 0
    assert verdict_of()["checks"]["reference"]["ok"]
    assert orchestrator("simulate", "paper7", "--steps", "300", "--run-dir", "local", "--no-record").returncode == 0
    assert parquet_bytes(Path("local")) == parquet_bytes(Path("runs/latest"))


def test_a_lost_machine_closes_its_edges(lab: Machines) -> None:
    with Network(lab, 200, "--rate", "100", "--deadline", "2") as network:
        network.wait_for("running")
        lab.cable("left", "down")
        for name in LEFT:
            network.wait_for(f"going on without agent {name}")
        assert network.wait() == 0, network.output
    assert verdict_of()["steps_done"] == 200
    assert verdict_of()["lost_rows"] == 0
    assert verdict_of()["checks"]["reference"]["ok"]
    last = pq.read_table("runs/latest/edges.parquet").to_pylist()[-6:]
    carries = {(edge["i"], edge["j"]): edge["open"] for edge in last}
    assert carries == {(i, j): i in RIGHT and j in RIGHT for i, j in carries}
