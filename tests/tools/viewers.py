"""Viewers of Rerun without a window, and what they and recordings show."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from hedgerow.orchestrator.views.rerun.viewer import Viewer, executable, native
from hedgerow.wire.ports import free_port

Array = NDArray[np.float64]


def until(condition: Callable[[], object], deadline_s: float = 60.0, every_s: float = 0.02) -> None:
    by, tick = time.monotonic() + deadline_s, threading.Event()
    while not condition():
        assert time.monotonic() < by, "the deadline passed"
        tick.wait(every_s)


def begin_headless(port: int | None = None, *options: str) -> Viewer:
    """A real viewer without a window, at `port` or any; skipped where there is no graphics driver."""
    viewer = native("--headless", *options, port=port)
    until(lambda: viewer.listens() or viewer.gone)
    try:
        until(lambda: viewer.gone or draws(viewer))
    finally:
        if viewer.gone:
            pytest.skip("the viewer does not start here: no graphics driver")
    return viewer


def draws(viewer: Viewer) -> bool:
    try:
        ViewerClient.connect(viewer.url).get_state()
    except RuntimeError:
        return False
    return True


def kill(viewer: Viewer) -> None:
    assert viewer.process is not None
    viewer.process.kill()
    viewer.process.wait()


def last_step(url: str) -> int:
    """The last step that the viewer at `url` has, -1 for none."""
    recordings = ViewerClient.connect(url).get_state().recordings
    ends = [line.end for one in recordings for line in one.timelines if line.name == "step"]
    return max((int(end) for end in ends if end is not None), default=-1)


class Saver:
    """A viewer that draws nothing and writes all received data to a file."""

    def __init__(self, path: Path) -> None:
        port = free_port()
        self.path, self.url = path, f"rerun+http://127.0.0.1:{port}/proxy"
        command = [str(executable()), "--bind", "127.0.0.1", "--port", str(port), "--save", str(path)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        Viewer(self.url).wait_until_it_listens()

    def close(self) -> None:
        """End it after it has written its received data: its file then stops growing."""
        sizes = [-1] * 20

        def still() -> bool:
            sizes[:] = [*sizes[1:], self.path.stat().st_size]
            return len(set(sizes)) == 1

        until(still)
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)

    def stores(self) -> dict[str, Path]:
        """Return its received recordings by name, one file each."""
        files = {}
        reader = RrdReader(self.path)
        for number, store in enumerate(reader.recordings()):
            files[store.recording_id] = self.path.with_name(f"{number}.rrd")
            reader.stream(store=store).write_rrd(
                files[store.recording_id], application_id="hedgerow", recording_id=store.recording_id
            )
        return files


def shown(files: list[Path] | Path, entity: str) -> tuple[Array, Array]:
    """The steps and the values, (rows, series), that recordings have of an entity, in the order of the steps."""
    steps: list[int] = []
    values: list[list[float]] = []
    for file in [files] if isinstance(files, Path) else files:
        reader = RrdReader(file)
        for store in reader.recordings():
            some = reader.stream(store=store).filter(
                content=f"/{entity}", is_static=False, has_timeline="step", components="Scalars:scalars"
            )
            for chunk in some:
                table = chunk.to_record_batch()
                steps += table.column("step").to_pylist()
                values += table.column("Scalars:scalars").to_pylist()
    order = np.argsort(steps, kind="stable")
    return np.array(steps, dtype=int)[order], np.array([values[k] for k in order], dtype=float)


def recorded(folder: Path, column: str, nodes: int = 7) -> Array:
    """Return a column of telemetry.parquet, one row per step."""
    values: Array = pq.read_table(folder / "telemetry.parquet")[column].to_numpy().astype(float).reshape(-1, nodes)
    return values


def assert_shows(files: list[Path] | Path, folder: Path, done: int | None = None) -> None:
    """Every column of telemetry.parquet is there, each step and node of it to the bit; up to `done` steps, or all."""
    x, x_oracle, x_nominal = (recorded(folder, name)[:done] for name in ("x", "x_oracle", "x_nominal"))
    for entity, expected in {"regret": np.abs(x - x_oracle), "nominal_gap": np.abs(x_oracle - x_nominal)}.items():
        np.testing.assert_array_equal(shown(files, entity)[1][:done], expected, err_msg=entity)
    step, node, *columns = pq.read_schema(folder / "telemetry.parquet").names
    assert (step, node) == ("step", "node")
    assert {"x", "u", "w", "ahat", "index", "margin", "x_oracle", "x_nominal"} == {*columns}
    np.testing.assert_array_equal(recorded(folder, step)[:, 0], np.arange(len(recorded(folder, step))))
    assert series(files, "x") == [[f"{k:.0f}" for k in recorded(folder, node)[0]]] * len(series(files, "x"))
    for column in columns:
        table = recorded(folder, column)
        if not column.startswith("x"):
            table = table[:-1] if done is None else table  # no input acts at the last step
        steps, values = (rows[:done] for rows in shown(files, column))
        expected = table[:done]
        np.testing.assert_array_equal(steps, np.arange(len(expected)), err_msg=column)
        assert bits(values) == bits(expected), column


def bits(values: Array) -> bytes:
    """Return the bits of values, with -0 distinct from 0, and all NaN equal."""
    return np.where(np.isnan(values), np.nan, values).tobytes()


def series(files: list[Path] | Path, entity: str) -> list[list[str]]:
    """The names of the series of an entity, in each recording; a part that was killed at its start has none."""
    return [
        chunk.to_record_batch().column("SeriesLines:names").to_pylist()[0]
        for file in ([files] if isinstance(files, Path) else files)
        for reader in (RrdReader(file),)
        for store in reader.recordings()
        for chunk in reader.stream(store=store).filter(content=f"/{entity}", is_static=True)
    ]
