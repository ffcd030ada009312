"""A large network whose telemetry lies in shared memory, and the same where it travels in messages."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tools.processes import orchestrator, parquet_bytes

NETWORK = (
    "{name: net, b: 0.1, steps: 200, graph: {kind: random_regular, nodes: 700, degree: 3, seed: 1},"
    " defaults: {x0: {random: [5, 15]}, candidates: {random: 3}, disturbance: {kind: white, std: 0.1}},"
    " faults: [{kind: drop, from: 0, to: %d, probability: 0.5}, {kind: crash, process: 1, at: 50, restart_after: 5}]}"
)
QUIET = ("--viewer", "none", "--no-record", "--processes", "2")


@pytest.mark.slow
def test_telemetry_is_the_same_to_the_byte(here: Path) -> None:
    from hedgerow.topologies.load import load  # noqa: PLC0415

    Path("net.yaml").write_text(NETWORK.split(", faults", maxsplit=1)[0] + "}")
    neighbour = next(j for i, j in load("net.yaml").pairs if i == 0)
    Path("net.yaml").write_text(NETWORK % neighbour)
    done = orchestrator("simulate", "net.yaml", "--no-record", "--set", "processes=2", "--run-dir", "simulated")
    assert done.returncode == 0, done.stderr
    done = orchestrator("up", "net.yaml", *QUIET, "--run-dir", "shared", "--verify")
    assert done.returncode == 0, done.stdout + done.stderr
    assert parquet_bytes(here / "shared") == parquet_bytes(here / "simulated")
