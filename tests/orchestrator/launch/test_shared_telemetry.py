"""A large network with its telemetry in shared memory: the tables are those of a run in one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tools.processes import orchestrator, parquet_bytes

HALVES = [list(range(350)), list(range(350, 700))]
NETWORK = (
    "{name: net, b: 0.1, steps: 200, processes: 2, graph: {kind: random_regular, nodes: 700, degree: 3, seed: 1},"
    " defaults: {x0: {random: [5, 15]}, candidates: {random: 3}, disturbance: {kind: white, std: 0.1}},"
    f" faults: [{{kind: partition, groups: {HALVES}, steps: [20, 30], cut: true}},"
    " {kind: crash, process: 1, at: 50, restart_after: 5}]}"
)


@pytest.mark.slow
def test_telemetry_is_the_same_to_the_byte(here: Path) -> None:
    Path("net.yaml").write_text(NETWORK)
    done = orchestrator("simulate", "net.yaml", "--no-record", "--run-dir", "simulated")
    assert done.returncode == 0, done.stderr
    done = orchestrator("up", "net.yaml", "--viewer", "none", "--no-record", "--run-dir", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    assert parquet_bytes(here / "run") == parquet_bytes(here / "simulated")
    # A resolved file holds the process of each node, for the fault of process 1.
    assert "\nlayout: [" in (here / "run" / "topology.yaml").read_text()
