"""Which numbers the seeds of a sweep and of a comparison draw, by how the network is given."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hedgerow as hg
from hedgerow.orchestrator.experiments.compare.plan import comparison
from hedgerow.orchestrator.experiments.sweep.plan import plan
from hedgerow.topologies.named import Named
from hedgerow.topologies.resolve import resolve

DRAWN: dict[str, Any] = {
    "name": "ring",
    "b": 0.1,
    "steps": 8,
    "graph": {"kind": "ring", "nodes": 5},
    "defaults": {"x0": 2, "candidates": {"random": 4}},
}
TEXT = "name: ring\nb: 0.1\nsteps: 8\ngraph: {kind: ring, nodes: 5}\ndefaults: {x0: 2, candidates: {random: 4}}\n"


def file() -> Path:
    Path("ring.yaml").write_text(TEXT)
    return Path("ring.yaml")


def simulated() -> Path:
    return hg.simulate(DRAWN).folder


@pytest.mark.parametrize(
    ("network", "runs"),
    [
        (file, 3),
        (lambda: TEXT, 3),
        (lambda: DRAWN, 3),
        (lambda: hg.Network(**DRAWN), 3),
        (lambda: hg.load(DRAWN), 3),
        (lambda: hg.load(hg.load(file(), law="hinf"), steps=9), 3),
        (lambda: hg.load(DRAWN).model_copy(update={"law": "hinf"}), 1),
        (lambda: hg.load(hg.load(DRAWN), "nodes.3.x0=1"), 3),
        (simulated, 1),
        (lambda: hg.load(simulated()), 1),
    ],
)
def test_seeds_draw_what_the_network_leaves_open(
    network: Callable[[], Named], runs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for planned in (plan(network(), "0:3", [], "in-process"), comparison(network(), ["hinf"], ["file"], range(3))):
        drawn = [
            resolve(planned.settings[0].topology.model_copy(update={"seed": seed}), planned.folder) for seed in range(3)
        ]
        assert len({tuple(one.network.a.tolist()) for one in drawn}) == runs


def test_the_settings_of_a_loaded_network_hold_for_every_seed() -> None:
    loaded = plan(hg.load(hg.load(DRAWN, steps=6), law="hinf"), "0:3", [], "in-process")
    assert loaded.identity == plan({**DRAWN, "steps": 6, "law": "hinf"}, "0:3", [], "in-process").identity


def test_a_disturbance_replaces_those_of_every_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = {**DRAWN, "nodes": {0: {"disturbance": {"kind": "constant", "value": 1}}}}
    planned = comparison(given, ["hinf"], ["none", "white"], range(1))
    for setting in planned.settings:
        (kind,) = {getattr(one.disturbance, "kind", None) for one in resolve(setting.topology).nodes.values()}
        assert kind == setting.values[0]


def test_copies_of_one_run_are_no_evidence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fifty equal pairs would give a p of 1e-15, and a winner."""
    monkeypatch.chdir(tmp_path)
    fixed = hg.compare(simulated(), disturbances=["file", "white"], seeds=range(12))
    for cell in fixed.cells:
        assert cell.n <= (1 if cell.disturbance == "file" else 12)
    for test in fixed.tests:
        assert not (test.disturbance == "file" and test.decided)
    assert any(test.pairs == 12 for test in fixed.tests)
