"""The names of a run, and the errors for folders and files that are no run."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.writer import Recorder
from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve, to_yaml
from tests.tools import networks
from tests.tools.recorded import ALONE, NETWORKS, ran
from tests.tools.refusals import refusal


def test_a_run_is_named_by_its_folder_its_name_or_its_network(here: Path) -> None:
    for name, steps in (("paper7-20260102-030405", 3), ("paper7-20260102-030405-2", 4), ("paper7-x", 5)):
        topology = resolve(load("paper7", [f"steps={steps}"]))
        ran(topology, here / "runs" / name)
    (here / "runs/latest").symlink_to("paper7-x", target_is_directory=True)
    assert load_run().T == 5
    assert load_run("runs/paper7-20260102-030405").T == load_run("paper7-20260102-030405").T == 3
    assert load_run("paper7").name == "paper7-20260102-030405-2"
    assert load_run(here / "runs" / "latest").name == "paper7-x"
    with refusal(Code.RUN_MISSING):
        load_run("paper")


def without(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).unlink()
    return folder


def test_a_folder_that_is_not_a_run_is_reported(paper7: Run, here: Path) -> None:
    def copy() -> Path:
        shutil.rmtree(here / "copy", ignore_errors=True)
        return shutil.copytree(paper7.folder, here / "copy")

    (here / "empty").mkdir()
    for folder, code in (
        (here / "nowhere", Code.RUN_MISSING),
        (here / "empty", Code.RUN_MISSING),
        (Path("x" * 300), Code.FILE_UNREADABLE),
    ):
        with refusal(code):
            load_run(folder)
    for name in ("telemetry.parquet", "edges.parquet"):
        with refusal(Code.RUN_MISSING):
            load_run(without(copy(), name))
    for name, content in (("telemetry.parquet", b"PAR1"), ("verdict.json", b"{")):
        folder = copy()
        (folder / name).write_bytes(content)
        with refusal(Code.FILE_FORMAT) as refused:
            load_run(folder)
        assert name in str(refused.value)
    folder = copy()
    (folder / "topology.yaml").write_bytes(b"name: [")
    with pytest.raises(TopologyError):
        load_run(folder)
    folder = without(copy(), "telemetry.parquet")
    (folder / "telemetry.arrows").write_bytes(b"")
    with refusal(Code.RUN_MISSING):
        load_run(folder)
    pq.write_table(paper7.telemetry().drop(["x_oracle"]), folder / "telemetry.parquet")
    with refusal(Code.FILE_FORMAT):
        load_run(folder).regret  # noqa: B018


def test_a_file_that_is_not_of_this_run_is_noticed(paper7: Run, here: Path) -> None:
    """The reader refuses numbers that were computed for another network."""
    text = (paper7.folder / "topology.yaml").read_text()
    (paper7.folder / "topology.yaml").write_text(text.replace("b: 0.1", "b: 0.101"))
    with refusal(Code.FILE_FORMAT):
        load_run(paper7.folder).cost  # noqa: B018
    (here / "three.yaml").write_text(ALONE.replace("[1]", "[1, 2, 3]"))
    (paper7.folder / "topology.yaml").write_text(to_yaml(resolve(load(str(here / "three.yaml")))))
    with refusal(Code.FILE_FORMAT):
        load_run(paper7.folder)


def test_a_text_that_came_to_harm_is_not_read_from_elsewhere(paper7: Run) -> None:
    """An Arrow stream stores the start of each text. Here that number is too large and points into foreign memory."""
    table, stream = paper7.telemetry(), paper7.folder / "telemetry.arrows"
    table = table.set_column(1, "node", table["node"].cast(pa.string()))  # as of nodes that have names
    with pa.ipc.new_stream(str(stream), table.schema) as writer:
        writer.write_table(table)
    begins = np.arange(8, dtype=np.int32).tobytes()  # of the first texts, one character each
    content = stream.read_bytes()
    assert begins in content
    stream.write_bytes(content.replace(begins, begins[:4] + b"\xff\xff\xff\x7f" + begins[8:]))
    without(paper7.folder, "telemetry.parquet")
    with refusal(Code.FILE_FORMAT):
        load_run(paper7.folder)


def test_a_run_without_a_complete_step_is_reported(here: Path) -> None:
    """One row is there, and the state after it is not."""
    topology = NETWORKS["paper7"]()
    folder, rows = create(topology, here / "run"), networks.simulate(topology).rows
    Recorder(topology, folder.path).write(Observer(topology).take(rows[:1]))
    with refusal(Code.RUN_MISSING):
        load_run(folder.path)


def test_a_file_in_place_of_a_run_is_named(tmp_path: Path) -> None:
    """The message does not call it missing."""
    file = tmp_path / "afile"
    file.touch()
    with refusal(Code.RUN_MISSING) as refused:
        load_run(file)
    assert "is a file" in str(refused.value)
