"""The slack of the certificate in the tables of a run: of every step, whenever the bounds became known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.recording import same_tables
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.guarantee import guarantee, plant_of
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs.export import export
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.writer import CLAIMS, Recorder
from hedgerow.orchestrator.views.screen import Quiet
from tests.orchestrator.metrics.test_gain_certificate import TEXT
from tests.tools.networks import read, simulate
from tests.tools.schedules import with_faults

CUT = [{"kind": "cut", "edge": [1, 2], "steps": [20, 22]}]


@pytest.mark.parametrize("late", [0, 1, 17, 40])
def test_the_table_does_not_depend_on_the_time_that_the_bounds_took(late: int, tmp_path: Path) -> None:
    """`late` is the step at which they are known; those before it wait."""
    topology = with_faults(read(TEXT), CUT)
    ran, known = simulate(topology), guarantee(plant_of(topology.network))
    paths = []
    for number, at in enumerate((0, late)):
        observer, folder = Observer(topology), tmp_path / str(number)
        folder.mkdir()
        observer.adaptive = GainCertificate(plant_of(topology.network), observer.x0)
        recorder = Recorder(topology, folder)
        for row in ran.rows:
            if row.t == at:
                observer.adaptive.known = known
            recorder.write(observer.take([row]))
        observer.adaptive.known = known
        observer.finish(ran.end)
        recorder.write_end(observer, ran.end)
        observer.adaptive.finish()
        recorder.close(observer.adaptive)
        paths.append(folder / "summary.parquet")
    assert paths[0].read_bytes() == paths[1].read_bytes()
    table = pq.read_table(paths[1])
    assert {name: table[name].null_count for name in CLAIMS} == dict.fromkeys(CLAIMS, 1)  # at step T none acts
    assert (np.array(table["ceiling_slack"])[:-1] > 0).all()


def recorded(folder: Path, *overrides: str) -> Path:
    topology = with_faults(read(TEXT, *overrides), CUT)
    simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    return folder


def without_claims(folder: Path) -> None:
    file = folder / "summary.parquet"
    pq.write_table(pq.read_table(file).drop_columns(CLAIMS), file)


def test_a_run_with_few_rows_has_the_slack_of_every_step(tmp_path: Path) -> None:
    whole, few = load_run(recorded(tmp_path / "a")), load_run(recorded(tmp_path / "b", "record={every: 9, nodes: [1]}"))
    assert not few.whole
    np.testing.assert_array_equal(few.ceiling_slack, whole.ceiling_slack)
    assert np.isfinite(few.ceiling_slack).all()
    (file,) = export(few, "npz", tmp_path / "few.npz")
    with np.load(file) as arrays:
        np.testing.assert_array_equal(arrays["ceiling_slack"], whole.ceiling_slack)


def test_a_folder_of_an_older_version_is_read(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run")
    now = load_run(folder).ceiling_slack
    without_claims(folder)
    old = load_run(folder)
    np.testing.assert_array_equal(old.ceiling_slack, now)
    (file,) = export(old, "npz", tmp_path / "old.npz")
    assert file.exists()
    few = recorded(tmp_path / "few", "record={every: 9}")
    without_claims(few)
    (file,) = export(load_run(few), "npz", tmp_path / "few.npz")
    with np.load(file) as arrays:
        assert "ceiling_slack" not in arrays
        assert "gain" in arrays


def test_a_run_without_bounds_has_the_same_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver that ran out of time is no difference between a run and its reference."""
    one = recorded(tmp_path / "one")

    def slow(_: PlantModel, __: float) -> None:
        raise OSError("out of time")

    monkeypatch.setattr("hedgerow.orchestrator.launch.recording.certified", slow)
    two = recorded(tmp_path / "two")
    assert np.isnan(load_run(two).ceiling_slack).all()
    assert same_tables(one, two)
    other = recorded(tmp_path / "three", "defaults.x0=3")
    assert not same_tables(one, other)
