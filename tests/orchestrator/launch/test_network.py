"""Networks of real processes over real Zenoh: their results, and what each process knows."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hedgerow.agents.view import View
from hedgerow.orchestrator.launch import launching
from hedgerow.wire.session import open_router
from tests.tools.networks import VECTORS, vector_file
from tests.tools.processes import QUIET, Orchestrator, orchestrator, parquet_bytes, run_here
from tests.tools.verdicts import CHECKS, verdict_of


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
def test_the_vectors_hold_with_one_process_a_node(path: Path, here: Path) -> None:
    text, expected = vector_file(path)
    (here / "vector.yaml").write_text(text)
    done = orchestrator("up", "vector.yaml", *QUIET, "--run-dir", "run")
    assert done.returncode == 0, done.stderr
    table = pq.read_table(here / "run" / "telemetry.parquet")
    shape = np.shape(expected["x"])
    x, u, index = (table[name].to_numpy(zero_copy_only=False).reshape(shape) for name in ("x", "u", "index"))
    assert np.abs(x - expected["x"]).max() <= 1e-12
    assert np.abs(u[:-1] - expected["u"]).max() <= 1e-12
    assert (index[:-1] == expected["index"]).all()
    verdict = verdict_of(here / "run")
    assert set(verdict["checks"]) == CHECKS
    assert verdict["metrics"]["gamma_star"] == pytest.approx(expected["gamma_star"], rel=1e-12)
    if "rho" in expected:
        assert verdict["metrics"]["rho"] == pytest.approx(expected["rho"], rel=1e-12)


@pytest.mark.slow
def test_every_layout_over_processes_gives_the_same_bits(here: Path) -> None:
    """paper7 for 1000 steps: simulated, twice with one process per node, in 3 and in 1: five equal pairs of files."""
    runs = {"simulated": ("simulate", "paper7", "--no-record")}
    for name, processes in (("seven", 7), ("seven again", 7), ("three", 3), ("one", 1)):
        runs[name] = ("up", "paper7", *QUIET, "--processes", str(processes))  # type: ignore[assignment]
    for name, arguments in runs.items():
        done = orchestrator(*arguments, "--steps", "1000", "--run-dir", name)
        assert done.returncode == 0, done.stdout + done.stderr
    reference = parquet_bytes(here / "simulated")
    assert all(parquet_bytes(here / name) == reference for name in runs)
    assert pq.read_metadata(here / "seven" / "telemetry.parquet").num_rows == 7 * 1001


def test_a_long_back_fill_causes_no_deadlock(here: Path) -> None:
    """Each side sends a megabyte at once, although the messages are usually short: this exceeds the buffer of a socket.

    Zenoh would close such a session after 5 s.
    """
    groups = [list(range(200)), list(range(200, 400))]
    partition = f"{{kind: partition, groups: {groups}, steps: [100, 600]}}"
    (here / "net.yaml").write_text(
        "{name: net, b: 0.1, steps: 700, graph: {kind: random_regular, nodes: 400, degree: 3, seed: 1},"
        f"defaults: {{x0: 1, candidates: {{random: 3}}}}, faults: [{partition}]}}"
    )
    assert orchestrator("simulate", "net.yaml", "--no-record", "--run-dir", "simulated").returncode == 0
    done = orchestrator("up", "net.yaml", "--processes", "2", *QUIET, "--run-dir", "run")
    assert done.returncode == 0, done.stderr
    assert parquet_bytes(here / "run") == parquet_bytes(here / "simulated")
    assert max(one["max_ms"] for one in verdict_of(here / "run")["round_trips"].values()) < 5000


def test_a_run_leaves_its_folder_and_its_verdict(here: Path) -> None:
    done = orchestrator("up", "paper7", "--viewer", "none", "--verify")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("valid: 30 of 30 steps")
    folder = here / "runs" / "latest"
    left = {path.name for path in folder.iterdir()}
    assert left == {
        "topology.yaml", "telemetry.parquet", "edges.parquet", "summary.parquet", "round_trips.parquet", "run.rrd",
        "events.jsonl", "verdict.json", "logs", "processes",
    }  # fmt: skip
    verdict = verdict_of(folder)
    assert verdict["verdict"] == "valid"
    assert all(check["ok"] for check in verdict["checks"].values())
    assert set(verdict["checks"]) == CHECKS | {"reference"}
    events = [json.loads(line)["event"] for line in (folder / "events.jsonl").read_text().splitlines()]
    assert events == ["start", "first_step", "recording", "verdict"]
    assert f"orchestrator open {folder.resolve()}" in done.stdout
    again = orchestrator("simulate", str(folder), "--run-dir", "again", "--no-record")
    assert again.returncode == 0, again.stderr
    assert parquet_bytes(here / "again") == parquet_bytes(folder)


def test_an_agent_is_a_process_that_knows_its_own_view_only(here: Path, paper7: Orchestrator) -> None:
    """There are eight separate processes. Agent 3 knows its neighbours 2 and 5, and no truth, graph or file."""
    start = json.loads((here / "runs/latest/events.jsonl").read_text().splitlines()[0])
    pids = set(start["pids"].values())
    assert len(pids) == 8
    assert all(Path(f"/proc/{pid}").exists() for pid in pids)
    view = json.loads(View.read(here / "runs/latest/processes/agent-3.json").to_json())
    assert set(view) == {"shard", "b", "law", "nodes", "peers", "history"}
    assert [set(node) for node in view["nodes"]] == [{"id", "candidates", "neighbours"}]
    assert view["nodes"][0]["neighbours"] == [2, 5]
    command = Path(f"/proc/{start['pids']['agent-3']}/cmdline").read_text()
    assert "topology.yaml" not in command
    assert "paper7.yaml" not in command
    mapped = Path(f"/proc/{start['pids']['agent-3']}/maps").read_text()
    assert "/numpy/" in mapped
    assert not any(package in mapped for package in ("/pydantic", "/rerun", "/scipy/", "/pyarrow"))


def test_two_networks_at_the_same_time_never_meet(here: Path) -> None:
    command = ("up", "paper7", *QUIET, "--verify")
    with Orchestrator(*command) as one, Orchestrator(*command) as other:
        assert one.wait() == 0, one.output
        assert other.wait() == 0, other.output
    folders = sorted(path for path in (here / "runs").iterdir() if not path.is_symlink())
    assert len(folders) == 2
    assert parquet_bytes(folders[0]) == parquet_bytes(folders[1])


def test_two_networks_share_an_existing_router(here: Path) -> None:
    endpoint = f"unixsock-stream/{here / 'shared.sock'}"
    with open_router(endpoint):
        command = ("up", "paper7", *QUIET, "--router", endpoint, "--verify")
        with Orchestrator(*command) as one, Orchestrator(*command) as other:
            assert one.wait() == 0, one.output
            assert other.wait() == 0, other.output


def test_a_missing_router_is_a_mistake_of_the_user(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`up` starts no process before it has found the router, so it runs in this process, with less patience."""
    monkeypatch.setattr(launching, "CONNECT_TIMEOUT_S", 0.1)
    done = run_here("up", "paper7", *QUIET, "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 3
    assert "tcp/127.0.0.1:1" in done.stdout + done.stderr


def test_the_agents_program_loads_little(here: Path) -> None:
    code = "import sys, agents.process; print(*sys.modules)"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & {"pydantic", "rerun", "scipy", "pyarrow", "yaml", "rich", "typer", "plant", "orchestrator"}
