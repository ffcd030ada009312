"""The certificate of the adaptive law in runs: never violated within its premises, and violated by a wrong plant."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Minimax, control
from hedgerow.agents.laws import LAWS
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch import recording
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.metrics.checks import Worst
from hedgerow.orchestrator.metrics.gain_bound import Method, Premise, bound
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.gain_plant import PlantModel
from hedgerow.orchestrator.metrics.guarantee import SOLVED, Guarantee, guarantee, plant_of
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.verdict import INVALID, VALID, Ending, judge
from hedgerow.orchestrator.runs.export import export
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import UserError
from hedgerow.topologies.graph import Array
from hedgerow.topologies.hinf import smallest_eigenpair
from hedgerow.topologies.schema import Topology
from tests.tools.examples import examples
from tests.tools.networks import VECTORS, Trajectory, from_vector, networks, read, simulate
from tests.tools.schedules import schedules, with_faults

EXAMPLES = int(os.environ.get("GAIN_EXAMPLES", "25"))
TEXT = json.dumps(
    {
        "name": "path",
        "b": 0.1,
        "steps": 40,
        "seed": 3,
        "nodes": [1, 2, 3],
        "edges": [[1, 2], [2, 3]],
        "defaults": {"a": 0.6, "candidates": [0.6, 0.3, 0.8], "nominal": 0.5, "x0": 2.0},
    }
)


class Random(Minimax):
    """Acts on any estimate between the smallest and the largest candidate."""

    def __init__(self, b: float, candidates: Array) -> None:
        super().__init__(b, candidates)
        self._low, self._high = np.nanmin(candidates, axis=0), np.nanmax(candidates, axis=0)
        self._random = np.random.default_rng(candidates.shape[1])

    def act(self, x: Array) -> Array:
        share = self._random.choice([0.0, 0.5, 1.0, self._random.random()])
        return control(self.b, x, self._low + share * (self._high - self._low))


COVERED = (
    f"{__name__}:Random",
    *(name for name in LAWS if name not in ("nominal", "robust", "bayes", "thompson")),
    "bayes(sigma=0.5)",
    "thompson(sigma=0.5)",
)
"""Laws that act within the lists."""


def certified(topology: Topology, ran: Trajectory, batch: int = 7, known: Guarantee | None = None) -> GainCertificate:
    """Return the certificate of a run with bounds known from the first step."""
    observer = Observer(topology)
    observer.adaptive = GainCertificate(plant_of(topology.network), observer.x0)
    observer.adaptive.known = guarantee(plant_of(topology.network)) if known is None else known
    for first in range(0, len(ran.rows), batch):
        observer.take(ran.rows[first : first + batch])
    observer.finish(ran.end)
    return observer.adaptive


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), law=st.sampled_from(COVERED))
def test_no_run_violates_the_certificate(data: st.DataObject, law: str) -> None:
    topology = data.draw(networks(steps=12))
    topology = with_faults(topology, data.draw(schedules(topology)), law=law)
    certificate = certified(topology, simulate(topology))
    for premise, track in certificate.tracks.items():
        assert track.check.excess <= 0, (premise, track)
        if premise in certificate.known.bounds:  # type: ignore[union-attr]
            covered = 12 if track.ended is None else track.ended
            assert track.check.steps == covered


@pytest.mark.parametrize(
    ("fault", "ended"),
    [
        (None, (None, None, None)),
        ({"kind": "drop", "from": 1, "to": 2, "steps": [4, 6]}, (None, None, None)),
        ({"kind": "delay", "from": 1, "to": 2, "by": 2, "steps": [4, 6]}, (None, None, None)),
        ({"kind": "cut", "edge": [1, 2], "steps": [5, 6]}, (5, None, None)),
        ({"kind": "actuator", "node": 3, "steps": [6, 9]}, (6, None, None)),
        ({"kind": "sensor", "node": 3, "steps": [6, 9]}, (6, None, None)),
        ({"kind": "crash", "node": 3, "at": 7, "restart_after": 2}, (7, None, None)),
        ({"kind": "jump", "node": 3, "at": 8, "a": 0.8}, (8, 8, None)),
    ],
)
def test_each_premise_ends_at_the_step_that_breaks_it(fault: dict[str, Any] | None, ended: tuple[int | None]) -> None:
    topology = with_faults(read(TEXT), [] if fault is None else [fault])
    certificate = certified(topology, simulate(topology))
    assert tuple(certificate.tracks[premise].ended for premise in Premise) == ended
    for track in certificate.tracks.values():
        assert track.check.excess <= 0
        assert track.check.steps == (40 if track.ended is None else track.ended)


def test_a_law_outside_the_sectors_is_not_covered() -> None:
    topology = read(TEXT.replace('"nominal": 0.5', '"nominal": 0.25'), "law=nominal")
    certificate = certified(topology, simulate(topology))
    assert {track.ended for track in certificate.tracks.values()} == {0}
    assert all("sector" in track.why for track in certificate.tracks.values())


def test_rows_that_come_before_the_bounds_are_checked_as_those_that_come_after() -> None:
    topology = with_faults(read(TEXT), [{"kind": "cut", "edge": [1, 2], "steps": [20, 22]}])
    ran, known = simulate(topology), guarantee(plant_of(topology.network))
    whole = certified(topology, ran, batch=40, known=known)
    for late in (1, 3, 40):
        observer = Observer(topology)
        observer.adaptive = later = GainCertificate(plant_of(topology.network), observer.x0)
        for number, row in enumerate(ran.rows):
            if number == late:
                later.known = known
            observer.take([row])
        later.known = known
        later.finish()
        assert later.tracks == whole.tracks
        assert later.to_dict(40) == whole.to_dict(40)


def test_a_lost_row_ends_every_premise() -> None:
    topology = read(TEXT)
    ran = simulate(topology)
    ran = dataclasses.replace(ran, rows=[row for row in ran.rows if row.t != 11])
    assert {track.ended for track in certified(topology, ran).tracks.values()} == {11}


def constant_run(plant: PlantModel, reported: Array, steps: int, scale: float) -> Worst:
    """Return the check of a run under hinf; the plant adds `scale` times the w that it reports, from x(0) = 0."""
    certificate = GainCertificate(plant, np.zeros(plant.n))
    certificate.known = Guarantee(1.0, {Premise.ESTIMATES: bound(plant, Premise.ESTIMATES)})
    incidence = np.zeros((plant.n, len(plant.edges)))
    for k, (i, j) in enumerate(plant.edges.tolist()):
        incidence[i, k], incidence[j, k] = plant.root_weights[k], -plant.root_weights[k]
    B = plant.b[:, None] * incidence
    x, sums = np.zeros(plant.n), np.zeros((1, 2))
    for t in range(steps):
        u = control(plant.b, x, plant.a)
        phi = B.T @ (-u / plant.b)
        after = plant.a * x - B @ phi + scale * reported
        sums = sums + np.array([x @ x + phi @ phi, reported @ reported])
        certificate.take(np.array([t]), x[None], u[None], after[None], np.array([True]), {}, sums)
        x = after
    return certificate.tracks[Premise.ESTIMATES].check


def test_a_plant_with_one_per_cent_more_w_than_reported_violates_it() -> None:
    """In this network, the worst constant disturbance of the oracle leaves no slack."""
    (path,) = (path for path in VECTORS if path.stem == "w1_path3")
    network = from_vector(path)[0].network
    w = smallest_eigenpair(network.a, network.b, network.graph)[1]
    assert constant_run(plant_of(network), w, 2000, 1.0).excess <= 0
    assert constant_run(plant_of(network), w, 2000, 1.01).excess > 0


def folder_run(topology: Topology, folder: Path) -> dict[str, Any]:
    found = simulate_into(topology, create(topology, folder), layout(topology, 1), Watching(record=False), Quiet())
    assert found.content == json.loads((folder / "verdict.json").read_text())
    return found.content


def test_a_run_leaves_its_bounds_and_their_slack(tmp_path: Path) -> None:
    content = folder_run(read(TEXT), tmp_path / "run")
    assert content["verdict"] == VALID
    for premise in ("estimates", "edges"):
        written, check = content["gain_bounds"]["bounds"][premise], content["checks"][f"gain_{premise}"]
        assert written["held"]
        assert check["steps"] == written["steps"] == 40
        assert written["slack"] > 0 > check["excess"]
        assert len(written["p"]) == 3


def test_a_recorded_run_has_the_bound_and_the_slack_of_every_step(tmp_path: Path) -> None:
    topology = with_faults(read(TEXT), [{"kind": "cut", "edge": [1, 2], "steps": [20, 22]}])
    content = folder_run(topology, tmp_path / "run")
    run = load_run(tmp_path / "run")
    written = content["gain_bounds"]["bounds"]
    np.testing.assert_array_equal(run.ceiling[:20], written["estimates"]["gain"])
    np.testing.assert_array_equal(run.ceiling[20:], written["edges"]["gain"])
    slack = {premise: run.certificate_slack(premise) for premise in Premise}
    assert np.isnan(slack[Premise.ESTIMATES][20:]).all()
    assert slack[Premise.ESTIMATES][19] == pytest.approx(written["estimates"]["slack"])
    assert slack[Premise.EDGES][-1] == pytest.approx(written["edges"]["slack"])
    assert (slack[Premise.EDGES] > 0).all()
    claimed = np.concatenate([slack[Premise.ESTIMATES][:20], slack[Premise.EDGES][20:]])
    np.testing.assert_array_equal(run.ceiling_slack, claimed)
    (file,) = export(run, "npz", tmp_path / "run.npz")
    with np.load(file) as arrays:
        np.testing.assert_array_equal(arrays["ceiling_slack"], claimed)
        np.testing.assert_array_equal(arrays["ceiling"], run.ceiling)
    with pytest.raises(UserError):
        run.certificate_slack("hope")


def test_a_network_too_large_for_a_bound_in_time_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "CERTIFIED", 2)
    content = folder_run(read(TEXT), tmp_path / "run")
    assert content["verdict"] == VALID
    assert "3 nodes" in content["gain_bounds"]["not_computed"]
    assert not any(name.startswith("gain_") for name in content["checks"])


def test_a_network_past_the_solver_is_certified_by_the_closed_forms(tmp_path: Path) -> None:
    ring = {"name": "ring", "b": 0.1, "steps": 3, "seed": 1, "graph": {"kind": "ring", "nodes": SOLVED + 1}}
    content = folder_run(read(json.dumps(ring | {"defaults": {"candidates": [0.2, 0.5, 0.8]}})), tmp_path / "run")
    assert content["verdict"] == VALID
    written = content["gain_bounds"]["bounds"]
    assert {written[premise]["method"] for premise in Premise} == {Method.UNIFORM}
    assert {content["checks"][f"gain_{premise}"]["steps"] for premise in Premise} == {3}


def test_a_violation_is_invalid() -> None:
    """The w in telemetry is smaller than that of the plant; the check of the dynamics is disabled."""
    topology = read(TEXT, "law=hinf", "defaults.x0=0", "defaults.disturbance={kind: constant, value: 1}", "steps=400")
    ran = simulate(topology)
    observer = Observer(topology)
    observer.adaptive = GainCertificate(plant_of(topology.network), observer.x0)
    observer.adaptive.known = guarantee(plant_of(topology.network))
    observer.take([row._replace(w=row.w / 4) for row in ran.rows])
    observer.finish(ran.end)
    for name in ("dynamics", "contraction", "oracle_certificate"):
        observer.checks.pop(name)
    content = judge(topology, observer, Ending("run", "in-process", 0)).content
    assert content["verdict"] == INVALID
    assert not content["checks"]["gain_estimates"]["ok"]


def test_every_fault_kind_was_drawn() -> None:
    kinds = {"drop", "delay", "cut", "partition", "sensor", "actuator", "crash", "jump"}
    seen: set[str] = set()
    topology = read(TEXT)

    @settings(max_examples=examples(60), deadline=None, database=None, derandomize=True)
    @given(schedules(topology))
    def look(faults: list[dict[str, Any]]) -> None:
        seen.update(fault["kind"] for fault in faults)

    look()
    assert kinds <= seen, kinds - seen
    assert len(list(itertools.chain(seen))) >= len(kinds)
