"""run.rrd, however a run ends, in one file or in parts: it equals the tables."""

from __future__ import annotations

import signal
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from hedgerow.orchestrator.runs.writer import to_parquet
from hedgerow.orchestrator.views.rerun.rrd_file import RrdFile, part_path, parts
from hedgerow.orchestrator.views.rerun.viewer import executable
from hedgerow.topologies.errors import Code
from tests.tools.processes import Orchestrator
from tests.tools.refusals import refusal
from tests.tools.viewers import (
    Array,
    assert_shows,
    recorded,
    series,
    shown,
    until,
)

pytestmark = [
    pytest.mark.usefixtures("without_display"),
    pytest.mark.filterwarnings("ignore:RRD file has no footer"),  # its writer was ended
]

LOST_S = 2.5
"""the time before a kill that may be missing from run.rrd, as in docs/watching.md [s]"""
SPLIT = ("--split-recording", "0.1")


def complete_steps(files: list[Path]) -> int:
    """Return how many steps all entities have; Rerun writes one entity after the other."""
    entities = ("x", "u", "w", "ahat", "index", "margin", "x_oracle", "x_nominal", "regret", "nominal_gap")
    return min(len(shown(files, entity)[0]) for entity in entities)


def is_recorded(path: Path, least_parts: int) -> bool:
    """Return True once a recording that grows has that many parts, and all of 200 steps."""
    files = parts(path)
    if len(files) < least_parts:
        return False
    try:
        return complete_steps(files) > 200
    except (RuntimeError, ValueError):  # Rerun writes the last piece just now
        return False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "split"), [("end", ()), ("Ctrl-C", SPLIT), ("SIGKILL", ()), ("SIGKILL", SPLIT)], ids=str
)
def test_run_rrd_equals_the_tables(ending: str, split: tuple[str, ...]) -> None:
    """To the bit, all columns, steps and nodes, in one file or in parts; of a killed run up to the last LOST_S."""
    rate, steps = 200, 500 if ending == "end" else 1_000_000
    with Orchestrator(
        "up", "paper7", "--processes", "1", "--steps", str(steps), "--rate", str(rate), "--viewer", "none", *split
    ) as up:
        up.wait_for("running")
        if ending != "end":
            until(partial(is_recorded, Path("runs/latest/run.rrd"), 1 + bool(split)), every_s=0.1)
            up.send(signal.SIGINT if ending == "Ctrl-C" else signal.SIGKILL)
        up.wait()
    folder = Path("runs/latest").resolve()
    files = parts(folder / "run.rrd")
    assert (len(files) > 1) == bool(split)
    if ending != "SIGKILL":
        assert len(series(files, "x")) == len(files)
        assert_shows(files, folder)
        return
    for name in ("telemetry", "edges"):
        to_parquet(folder / f"{name}.arrows", folder / f"{name}.parquet")
    kept, done = len(recorded(folder, "x")), complete_steps(files)
    assert kept - done <= LOST_S * rate, (kept, done)
    assert_shows(files, folder, min(kept, done))


def streams(sink: rr.FileSink) -> rr.RecordingStream:
    stream = rr.RecordingStream("story", recording_id="long")
    stream.set_sinks(sink)
    stream.log("x", rr.SeriesLines(names=["one"]), static=True)
    return stream


def send(stream: rr.RecordingStream, values: Array, first: int) -> None:
    index = [rr.TimeColumn("step", sequence=np.arange(first, first + len(values)))]
    stream.send_columns("x", index, rr.Scalars.columns(scalars=values))


def test_a_recording_continues_in_parts(tmp_path: Path) -> None:
    """Each part has about the requested size and begins with the static data; together they have all rows."""
    path = tmp_path / "run.rrd"
    file = RrdFile(path, streams, part_bytes=200_000)
    values = np.random.default_rng(1).normal(size=(100, 500, 1))
    for k in range(100):
        file.write(partial(send, values=values[k], first=500 * k))
        file._stream.flush(timeout_sec=10.0)
    file.close(5.0)
    written = parts(path)
    assert written[0] == path
    assert written[1] == part_path(path, 1) == tmp_path / "run-001.rrd"
    assert len(written) >= 3
    assert all(part.stat().st_size < 300_000 for part in written)
    for part in written:
        assert len(RrdReader(part).stream().filter(content="/x", is_static=True).to_chunks()) == 1
    steps, found = shown(written, "x")
    np.testing.assert_array_equal(steps, np.arange(50_000))
    np.testing.assert_array_equal(found, values.reshape(-1, 1))

    whole = tmp_path / "whole.rrd"
    command = [str(executable()), "rrd", "merge", *map(str, written), "-o", str(whole)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    np.testing.assert_array_equal(shown(whole, "x")[1], values.reshape(-1, 1))


def test_a_deleted_part_causes_no_error(tmp_path: Path) -> None:
    file = RrdFile(tmp_path / "run.rrd", streams, part_bytes=10**9)
    (tmp_path / "run.rrd").unlink()
    file.write(lambda stream: stream.log("x", rr.Scalars([1.0])))
    file.close(5.0)
    assert parts(tmp_path / "run.rrd") == [tmp_path / "run-001.rrd"]


def test_a_part_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with refusal(Code.OUTPUT, str(tmp_path / "missing/run.rrd")):
        RrdFile(tmp_path / "missing" / "run.rrd", streams)
