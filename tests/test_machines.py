"""A network over four machines: the router on one, agents on two, the plant and the observer on the fourth."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from tests.machines import ROUTER, Machines, Program, machines
from tests.processes import Orchestrator, orchestrator, parquet_bytes

pytestmark = pytest.mark.slow
LEFT, RIGHT = (1, 2, 3), (4, 5, 6, 7)
AGENT = (sys.executable, "-P", "-c", "from agents.anywhere import main; main()")


@pytest.fixture
def lab(here: Path) -> Iterator[Machines]:
    with machines("router", "left", "right", "bench") as lab:
        yield lab


class Network:
    """paper7 over the machines."""

    def __init__(self, lab: Machines, steps: int, *options: str) -> None:
        self._lab, self._folder = lab, Path.cwd() / "lab"
        told = ("paper7", "--steps", str(steps), "--router", "tcp/router:7447")
        assert orchestrator("bundle", *told, "--out", "lab").returncode == 0
        self._programs = [
            Program(lab.on("router"), (sys.executable, "-c", ROUTER, "tcp/0.0.0.0:7447"), Path("r").absolute())
        ]
        for machine, names in (("left", LEFT), ("right", RIGHT)):
            for name in names:
                words = (*AGENT, "--config", str(self._folder / f"agent-{name}.toml"))
                self._programs.append(Program(lab.on(machine), words, Path(f"{machine}-{name}").absolute()))
        self.up = Orchestrator(
            *("up", *told, "--external", "all", "--viewer", "none", "--no-record", "--verify", *options),
            inside=lab.on("bench"),
        )

    def __enter__(self) -> Orchestrator:
        return self.up

    def __exit__(self, *_: object) -> None:
        self.up.__exit__(None, None, None)
        for program in self._programs:
            program.end()


def verdict() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path("runs/latest/verdict.json").read_text())
    return found


def test_a_cable_that_is_pulled_and_put_back_costs_time_and_nothing_else(lab: Machines) -> None:
    with Network(lab, 300, "--rate", "100") as network:
        network.wait_for("running")
        lab.cable("left", "down")
        network.wait_for_log("plant", "repeated, still without shards", 4)
        lab.cable("left", "up")
        assert network.wait() == 0, network.output
    assert verdict()["verdict"] == "valid"
    assert verdict()["missing_inputs"] == verdict()["lost_rows"] == 0
    assert verdict()["checks"]["reference"]["ok"]
    assert orchestrator("simulate", "paper7", "--steps", "300", "--run-dir", "local", "--no-record").returncode == 0
    assert parquet_bytes(Path("local")) == parquet_bytes(Path("runs/latest"))


def test_a_machine_that_is_gone_for_good_costs_its_edges(lab: Machines) -> None:
    with Network(lab, 200, "--rate", "100", "--deadline", "2") as network:
        network.wait_for("running")
        lab.cable("left", "down")
        for name in LEFT:
            network.wait_for(f"going on without agent {name}")
        assert network.wait() == 0, network.output
    assert verdict()["steps_done"] == 200
    assert verdict()["lost_rows"] == 0
    assert verdict()["checks"]["reference"]["ok"]
    last = pq.read_table("runs/latest/edges.parquet").to_pylist()[-6:]
    carries = {(edge["i"], edge["j"]): edge["open"] for edge in last}
    assert carries == {(i, j): i in RIGHT and j in RIGHT for i, j in carries}
