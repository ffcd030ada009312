"""Large networks that use shared memory: the tables are those of a run in one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tools.processes import orchestrator, parquet_bytes


def network(nodes: int) -> str:
    """Return a network of two processes with faults."""
    halves = [list(range(nodes // 2)), list(range(nodes // 2, nodes))]
    return (
        f"{{name: net, b: 0.1, steps: 200, processes: 2, graph: {{kind: random_regular, nodes: {nodes}, degree: 3,"
        " seed: 1}, defaults: {x0: {random: [5, 15]}, candidates: {random: 3}, disturbance: {kind: white, std: 0.1}},"
        f" faults: [{{kind: partition, groups: {halves}, steps: [20, 30], cut: true}},"
        " {kind: crash, process: 1, at: 50, restart_after: 5}]}"
    )


@pytest.mark.slow
@pytest.mark.parametrize("nodes", [700, 1400], ids=["telemetry", "telemetry, states and inputs"])
def test_tables_are_the_same_to_the_byte(here: Path, nodes: int) -> None:
    Path("net.yaml").write_text(network(nodes))
    done = orchestrator("simulate", "net.yaml", "--no-record", "--run-dir", "simulated")
    assert done.returncode == 0, done.stderr
    done = orchestrator("up", "net.yaml", "--viewer", "none", "--no-record", "--run-dir", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    assert parquet_bytes(here / "run") == parquet_bytes(here / "simulated")
    # A resolved file or its table holds the process of each node, for the fault of process 1.
    assert (here / "run" / "network.npz").exists() or "\nlayout: [" in (here / "run" / "topology.yaml").read_text()
