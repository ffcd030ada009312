"""A run folder that is changed after the run: each change is found, or refused with a message."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.launch.simulation import simulate as recorded
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.writer import SUMMARY
from hedgerow.topologies.errors import HedgerowError

FAULTS = [{"kind": "drop", "link": [2, 4], "steps": [5, 9]}, {"kind": "crash", "node": 3, "at": 10, "restart_after": 3}]


def column(table: str, name: str, row: int) -> Callable[[Path], None]:
    """Return a change of one number of a table."""

    def change(run: Path) -> None:
        file = run / f"{table}.parquet"
        read = pq.read_table(file)
        k = read.column_names.index(name)
        values = np.array(read.column(name).to_pylist())
        values[row] = not values[row] if values.dtype == bool else values[row] + 1
        pq.write_table(read.set_column(k, read.schema.field(k), pa.array(values, read.schema.field(k).type)), file)

    return change


def shorter(run: Path) -> None:
    """Leave out the last steps."""
    for name, rows in (("telemetry", 7), ("edges", 6), ("summary", 1)):
        read = pq.read_table(run / f"{name}.parquet")
        pq.write_table(read.slice(0, 20 * rows), run / f"{name}.parquet")


def text(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Return a change of a text file."""

    def change(run: Path) -> None:
        content = (run / name).read_text()
        assert old in content
        (run / name).write_text(content.replace(old, new))

    return change


def no_check(run: Path) -> None:
    """Write a failed check into a verdict that stays valid."""
    content = json.loads((run / "verdict.json").read_text())
    content["checks"]["dynamics"]["ok"] = False
    (run / "verdict.json").write_text(json.dumps(content))


def metric(run: Path) -> None:
    """Write another number into the metrics of a verdict."""
    content = json.loads((run / "verdict.json").read_text())
    content["metrics"]["regret"] /= 2
    (run / "verdict.json").write_text(json.dumps(content))


CHANGES = {
    "x": column("telemetry", "x", 100),
    "u": column("telemetry", "u", 100),
    "w": column("telemetry", "w", 100),
    "the final x": column("telemetry", "x", -1),
    "ahat": column("telemetry", "ahat", 100),
    "x of the oracle": column("telemetry", "x_oracle", 100),
    "x of the nominal": column("telemetry", "x_nominal", 100),
    "a margin": column("telemetry", "margin", 100),
    "a cost": column("summary", "cost_sum", 5),
    "the input of an edge": column("edges", "u_edge", 100),
    "an open edge": column("edges", "open", 100),
    "a delivery": column("edges", "i_hears", 100),
    "the step of a row": column("telemetry", "step", 100),
    "the node of a row": column("telemetry", "node", 100),
    "the end of an edge": column("edges", "j", 100),
    "the final x of the oracle": column("telemetry", "x_oracle", -1),
    **{f"{name} of the summary": column("summary", name, 5) for name in SUMMARY},
    **{
        f"the final {name} of the summary": column("summary", name, -1)
        for name in ("x_sum", "regret_max", "regret_sum", "checksum")
    },
    "a metric of the verdict": metric,
    "the seed of the verdict": text("verdict.json", '"seed": 1', '"seed": 2'),
    "the number of steps": shorter,
    "the gain": text("topology.yaml", "b: 0.1", "b: 0.11"),
    "the seed of the faults": text("topology.yaml", "kind: drop", "kind: delay\n  by: 1"),
    "the word of a verdict": text("verdict.json", '"verdict": "valid"', '"verdict": "INVALID"'),
    "a check of a verdict": no_check,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("whole"))
        run = recorded("paper7", f"faults={json.dumps(FAULTS)}")
        assert run.first_difference() is None
        return run.folder.absolute()


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_after_the_run_is_found(what: str, whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    CHANGES[what](folder)
    try:
        found = load_run(folder).first_difference()
    except HedgerowError:
        return
    assert found is not None


@pytest.mark.parametrize("law", ["minimax", "rls", "thompson", "set-membership"])
@pytest.mark.parametrize("candidates", ["[0.5]", "[0.4, 0.5]"])
def test_an_unchanged_folder_has_no_difference(law: str, candidates: str, here: Path) -> None:
    """Also with one candidate: its margin is infinite, and the table has null for it."""
    network = {"nodes": [1, 2, 3], "edges": [[1, 2], [2, 3]], "defaults": {"candidates": json.loads(candidates)}}
    (here / "three.yaml").write_text(json.dumps({"name": "three", "b": 0.1, "steps": 20, "seed": 1, **network}))
    assert recorded("three.yaml", f"law={law}").first_difference() is None
