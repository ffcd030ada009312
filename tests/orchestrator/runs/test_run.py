"""A loaded run: its arrays are those that were computed live, and it is made as by the command."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from hedgerow import simulate
from hedgerow.orchestrator.runs.run import Run
from hedgerow.topologies.errors import Code
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty
from tests.tools import networks
from tests.tools.documents import ROOT
from tests.tools.networks import observe
from tests.tools.recorded import assert_as_live, ran, same
from tests.tools.refusals import refusal


@settings(max_examples=10)
@given(topology=faulty())
def test_every_array_equals_the_live_one(topology: Topology) -> None:
    """The network has any faults: jumps, crashes, cuts, lost messages."""
    with tempfile.TemporaryDirectory() as folder:
        run = ran(topology, Path(folder) / "run")
        observer, live = observe(topology, networks.simulate(topology))
        assert (run.T, run.ids, list(run.lost)) == (topology.steps, topology.ids, [])
        assert_as_live(run, live, observer)
        ended = {name: None if value is None else float(value) for name, value in run.metrics.items()}
        assert ended == run.verdict.content["metrics"]


def test_identifiable_models_are_estimated(paper7: Run) -> None:
    """Without missing samples, (7) chooses the candidate nearest to a_LS, which is a + beta."""
    known = np.isfinite(paper7.a_ls)
    assert (paper7.identifiable == (paper7.ahat == paper7.a))[known].all()
    assert 0 < paper7.identifiable[known].sum() < known.sum()
    np.testing.assert_allclose(paper7.a_ls[known], (paper7.a + paper7.beta)[known], rtol=1e-12)
    assert paper7.faultless


def test_a_run_has_the_received_messages(run: Run) -> None:
    """Arrays of edges have the ends where the file has them."""
    for k, (i, j) in enumerate(run.edges):
        assert (run.ids[i], run.ids[j]) == run.topology.pairs[k]
        flows = np.where(run.edge_open[:, k], run.u[:, j] - run.u[:, i], 0.0)
        assert same(run.u_edge[:, k], flows)
    if run.name == "named":
        assert np.flatnonzero(~run.i_hears[:, 0]).tolist() == [2, 3, 4, 6, 7]  # messages of 3, until it dies
        assert np.flatnonzero(~run.edge_open[:, 0]).tolist() == [4, 5, 6, 7]
        assert (
            np.flatnonzero(np.isnan(run.u[:, 2])).tolist() == np.flatnonzero(run.index[:, 2] == -1).tolist() == [6, 7]
        )
    else:
        assert run.i_hears.all()
        assert run.j_hears.all()


def test_a_run_cannot_be_changed(run: Run) -> None:
    found = 0
    for name in dir(run):
        if not name.startswith("_") and isinstance(values := getattr(run, name), np.ndarray):
            found += 1
            assert not values.flags.writeable, name
            assert getattr(run, name) is values, f"{name} is read twice"
    assert found >= 30
    with pytest.raises(AttributeError):
        run.folder = Path()  # type: ignore[misc]


def test_a_run_is_made_as_by_the_command(paper7: Run, here: Path) -> None:
    bundled = str(ROOT / "topologies/paper7.yaml")  # a run of the same name lies here
    run = simulate(bundled, "steps=30", run_dir="mine")
    assert run.folder == here / "mine"
    assert all(
        (run.folder / name).read_bytes() == (paper7.folder / name).read_bytes()
        for name in ("topology.yaml", "telemetry.parquet", "edges.parquet")
    )
    with refusal(Code.OUTPUT):
        simulate(bundled, run_dir="mine")


def test_a_run_of_no_step_is_none(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "bad.py").write_text(
        "from hedgerow.agents.law import Minimax\n\n"
        "class Bad(Minimax):\n    def act(self, x): raise ValueError('no')\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(here)
    with refusal(Code.LAW):
        simulate("ring6", "law=bad:Bad")
    with refusal(Code.LAW):
        simulate("ring6", "law=bad:Good", run_dir="never")
    assert not (here / "never").exists()
