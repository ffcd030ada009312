"""Public networks over Zenoh: imported, checked and run by the commands that a user types."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import networkx as nx
import pyarrow.parquet as pq
import pytest

from tests.tools.importing import needs, shipped
from tests.tools.processes import orchestrator


def graphml(make: Any) -> Path:
    graph = make()
    graph.graph.clear()  # GraphML has no lists
    nx.write_graphml(graph, "graph.graphml")
    return Path("graph.graphml")


SOURCES = {
    "karate": lambda: graphml(nx.karate_club_graph),
    "florentine": lambda: graphml(nx.florentine_families_graph),
    "nobel-eu": lambda: shipped("topohub", "data", "sndlib", "nobel-eu.json"),
    "Net1": lambda: shipped("wntr", "library", "networks", "Net1.inp"),
    "case9": lambda: shipped("pandapower", "networks", "power_system_test_case_jsons", "case9.json"),
    "case14": lambda: shipped("matpower", "data", "case14.m"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SOURCES)
def test_a_public_network_is_imported_checked_and_run_in_processes(name: str, here: Path) -> None:
    if name == "case14":
        needs("matpowercaseframes")
    done = orchestrator("import", str(SOURCES[name]()), "-o", "net.yaml", "--steps", "20")
    assert done.returncode == 0, done.stderr
    assert orchestrator("check", "net.yaml").returncode == 0
    done = orchestrator(
        "up", "net.yaml", "--processes", "3", "--viewer", "none", "--no-record", "--verify", "--run-dir", "run"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = json.loads(Path("run/verdict.json").read_text())
    assert (verdict["steps"], verdict["processes"]) == (20, 3)
    assert pq.read_metadata("run/telemetry.parquet").num_rows == 21 * verdict["nodes"]
