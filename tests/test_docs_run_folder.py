"""docs/run-folder.md describes each file, column and field of a run folder, and the folder of an interrupted run."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.ipc
import pyarrow.parquet as pq

from hedgerow.orchestrator.runs.writer import to_parquet
from tests.tools.documents import COMMAND_DEADLINE_S, ROOT, Scratch, table
from tests.tools.networks import observe, read, simulate


def orchestrator(scratch: Scratch, *arguments: str) -> subprocess.Popen[str]:
    """A command that runs on, with its output to be read line by line."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "hedgerow.orchestrator", *arguments],
        cwd=scratch.folder,
        env=scratch.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_the_run_folder_is_as_described(tmp_path: Path) -> None:
    """Every file, every column and its type, and every field of the verdict is on the page, and nothing is missing."""
    scratch = Scratch(tmp_path)
    code, printed = scratch.run("orchestrator", "up", "paper7", "--viewer", "none", "--run-dir", "run")
    assert code == 0, printed
    run = tmp_path / "run"

    left = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    patterns = {row["file"] for row in table("run-folder.md", "Files")}
    expressions = {pattern: re.escape(pattern).replace("NAME", r"[\w.-]+") for pattern in patterns}
    described = {pattern for pattern in patterns if any(re.fullmatch(expressions[pattern], file) for file in left)}
    assert [file for file in left if not any(re.fullmatch(e, file) for e in expressions.values())] == []
    streams = {"telemetry.arrows", "edges.arrows", "summary.arrows", "round_trips.arrows"}
    sometimes = {*streams, "logs/up.log", "run-NNN.rrd", "network.npz"}
    assert patterns - described == sometimes

    for name in ("telemetry", "edges", "summary", "round_trips"):
        schema = pq.read_schema(run / f"{name}.parquet")
        columns = [(row["column"], row["type"]) for row in table("run-folder.md", f"{name}.parquet")]
        assert columns == [(field.name, str(field.type)) for field in schema]

    verdict = json.loads((run / "verdict.json").read_text())
    assert [row["field"] for row in table("run-folder.md", "verdict.json")] == list(verdict)
    assert [row["check"] for row in table("run-folder.md", "verdict.json", 1)] == list(verdict["checks"])
    assert {row["field"] for row in table("run-folder.md", "verdict.json", 2)} == verdict["metrics"].keys()
    (figures,) = {tuple(one) for one in verdict["round_trips"].values()}
    assert all(f"`{name}`" in (ROOT / "docs/run-folder.md").read_text(encoding="utf-8") for name in figures)

    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "orchestrator").rglob("*.py")]
    events = {event for source in sources for event in re.findall(r'folder\.event\(\s*"(\w+)"', source)}
    assert events == {row["event"] for row in table("run-folder.md", "events.jsonl")}


def test_the_sign_of_an_edge_input() -> None:
    """u_edge of the edge (i, j) is u_j - u_i, as in docs/run-folder.md."""
    topology = read("{name: pair, b: 0.1, steps: 3, defaults: {x0: 5}, nodes: {1: {}, 2: {x0: 1}}, edges: [[2, 1]]}")
    _, batch = observe(topology, simulate(topology))
    np.testing.assert_array_equal(batch.u_edge[:, 0], batch.u[:, 0] - batch.u[:, 1])


LONG = ("paper7", "--steps", "1000000", "--viewer", "none", "--no-record", "--run-dir", "run")


def started(scratch: Scratch) -> subprocess.Popen[str]:
    """A long run of which some steps are recorded."""
    process = orchestrator(scratch, "up", *LONG)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("step "):
            return process
    raise AssertionError("the run ended before its first step")


def test_ctrl_c_leaves_a_complete_folder(tmp_path: Path) -> None:
    """Exit code 3, the verdict unknown, and tables that can be read."""
    process = started(Scratch(tmp_path))
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=COMMAND_DEADLINE_S)

    assert process.returncode == 3, printed
    verdict = json.loads((tmp_path / "run/verdict.json").read_text())
    assert verdict["verdict"] == "unknown"
    telemetry = pq.read_table(tmp_path / "run/telemetry.parquet")
    assert telemetry.num_rows == 7 * (verdict["steps_done"] + 1)


def test_sigkill_leaves_a_stream_that_becomes_a_table(tmp_path: Path) -> None:
    """No verdict, but every batch that was written is there, and `to_parquet` reads up to the last whole one."""
    process = started(Scratch(tmp_path))
    process.kill()
    process.communicate(timeout=COMMAND_DEADLINE_S)

    run = tmp_path / "run"
    assert not (run / "verdict.json").exists()
    to_parquet(run / "telemetry.arrows", run / "telemetry.parquet")
    telemetry = pq.read_table(run / "telemetry.parquet")
    assert telemetry.num_rows > 0
    assert telemetry.num_rows % 7 == 0
    with pyarrow.OSFile(str(run / "telemetry.arrows")) as source, pyarrow.ipc.open_stream(source) as stream:
        assert stream.schema == telemetry.schema
