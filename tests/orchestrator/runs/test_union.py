"""Runs side by side have the bits of each run by itself, whatever the law, the faults and the network."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan, plan
from hedgerow.orchestrator.experiments.sweep.runs import _content, _row, _row_at_once, answer
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.ground.laws import completed
from hedgerow.orchestrator.runs import batch, reference
from hedgerow.orchestrator.runs.union import of_seeds
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from tests.tools.networks import gathered, networks
from tests.tools.schedules import schedules, with_faults

HISTORIES: list[dict[str, Any]] = [{}, {"history": 3}, {"backfill": False}]
EXAMPLES = int(os.environ.get("HEDGEROW_EXAMPLES", "25"))


def same_bits(topology: Topology, seeds: list[int]) -> None:
    """Compare the telemetry of a union with that of single runs, bit for bit: x, w and the reports of the agents."""
    union = of_seeds(topology, seeds)
    together = gathered(reference.run(union.truth(), [union.view()], union.law()))
    edge, link = 0, 0
    for k, seed in enumerate(seeds):
        own = completed(resolve(topology.model_copy(update={"seed": seed})))
        shards = layout(own, 1)
        alone = gathered(reference.run(truth_of(own, shards), views_of(own, shards)))
        nodes, e = slice(k * union.n, (k + 1) * union.n), len(own.network.graph.edges)
        edges, links = slice(edge, edge + e), slice(link, link + 2 * e)
        edge, link = edge + e, link + 2 * e
        for one, other in zip(together.rows, alone.rows, strict=True):
            t = f"seed {seed}, step {one.t}"
            for name, part in (("x", nodes), ("u", nodes), ("w", nodes), ("edge_open", edges), ("link_up", links)):
                assert getattr(one, name)[part].tobytes() == getattr(other, name).tobytes(), f"{name}: {t}"
            assert one.report[:, nodes].tobytes() == other.report.tobytes(), f"report: {t}"
        assert together.end.x[nodes].tobytes() == alone.end.x.tobytes()


@given(st.data())
@settings(max_examples=EXAMPLES, deadline=None)
def test_any_faults_in_any_network_have_the_bits_of_single_runs(data: st.DataObject) -> None:
    topology = data.draw(networks(most=4, steps=12))
    law = data.draw(st.sampled_from(["minimax", "notch", "thompson", "rls", "tests.tools.laws:LeastSquares"]))
    faults = data.draw(schedules(topology, 4))
    history = data.draw(st.sampled_from(HISTORIES))
    same_bits(with_faults(topology, faults, law=law, **history), [3, 1, 8])


FILES: dict[str, list[str]] = {
    "drops": ["faults=[{kind: drop, link: [2, 4], probability: 0.5}, {kind: drop, link: [1, 2], probability: 0.3}]"],
    "delays and a cut": [
        "faults=[{kind: delay, from: 3, to: 5, by: 2, probability: 0.4}, {kind: cut, edge: [2, 3], steps: [4, 9]}]"
    ],
    "crashes": ["faults=[{kind: crash, node: 3, at: 8, restart_after: 4}, {kind: crash, node: 4, at: 20}]"],
    "actuator and sensor": [
        "faults=[{kind: actuator, node: 2, probability: 0.2}, {kind: sensor, node: 6, probability: 0.2}]"
    ],
    "a partition": ["faults=[{kind: partition, groups: [[1, 2, 3], [4, 5, 6, 7]], cut: true, steps: [5, 11]}]"],
    "random jumps": ["faults=[{kind: jump, node: 2, at: 9, a: random}, {kind: jump, node: 5, at: 15, a: random}]"],
    "unequal gains": ["defaults.b={random: [0.05, 0.1]}"],
    "unequal weights": [
        "edges=[{ends: [1, 2], weight: 0.5}, {ends: [2, 3], weight: {random: [0.5, 1]}}, [2, 4],"
        " [3, 5], [4, 6], [6, 7]]"
    ],
    "confuse": ["defaults.disturbance={kind: confuse, candidate: random}"],
    "coloured noise": ["defaults.disturbance={kind: ar1, phi: 0.9, std: 0.1}"],
    "worst case": ["disturbance=worst_case"],
    "robust": ["law=robust"],
    "thompson": ["law=thompson"],
    "notch under drops": ["law=notch", "faults=[{kind: drop, link: [2, 4], probability: 0.5}]"],
    "a law that asks, under drops": [
        "law=tests.tools.laws:Curious",
        "faults=[{kind: drop, link: [2, 4], probability: 0.5}, {kind: crash, node: 3, at: 8, restart_after: 4}]",
    ],
}
RULES = {
    "a random tree": "{kind: random_tree, nodes: 6}",
    "a random graph": "{kind: geometric, nodes: 8, mean_degree: 3, weight: {random: [0.5, 1]}}",
}


def swept(name: str, folder: Path, seeds: str = "0:5") -> Plan:
    if name in FILES:
        return plan("paper7", seeds, FILES[name], "in-process")
    file = folder / "network.yaml"
    file.write_text(f"name: rule\nb: 0.05\nsteps: 20\ngraph: {RULES[name]}\ndefaults: {{candidates: {{random: 4}}}}\n")
    return plan(str(file), seeds, [], "in-process")


@pytest.mark.parametrize("name", [*FILES, *RULES])
def test_runs_at_once_have_the_bits_of_single_runs(name: str, tmp_path: Path) -> None:
    same_bits(swept(name, tmp_path).settings[0].topology, [0, 1, 2])


@pytest.mark.parametrize("name", [*FILES, *RULES])
def test_runs_at_once_have_the_metrics_and_the_verdict_of_single_runs(name: str, tmp_path: Path) -> None:
    sweep = swept(name, tmp_path)
    topology, seeds = sweep.settings[0].topology, tuple(sweep.seeds)
    assert not any(sweep.one_by_one)
    runs = batch.run(topology, seeds)
    for k, seed in enumerate(seeds):
        row = _row(_content(sweep, 0, seed))
        assert (row["verdict"] == "valid") == bool(runs.good[k]), row["reasons"]
        if name == "a random graph":
            made = _row_at_once(runs, k)
            known = {key: value for key, value in row.items() if isinstance(value, float)}
            assert {key: made[key] for key in known} == pytest.approx(known, rel=1e-12)
        else:
            assert _row_at_once(runs, k) == row


def test_a_fault_that_cannot_fire_is_judged_by_itself() -> None:
    sweep = plan("paper7", "0:3", ["faults=[{kind: cut, edge: [1, 2], steps: [40, 50]}]"], "in-process")
    assert not batch.run(sweep.settings[0].topology, range(3)).good.any()
    rows = answer(sweep, Chunk(0, (0, 1, 2)))
    assert isinstance(rows, list)
    assert {row["verdict"] for row in rows} == {"unknown"}


class OwnIds:
    """Finds its neighbours by their ids, which repeat where runs lie side by side."""

    def __init__(self, b: float, candidates: Any, *, local: Any) -> None:
        place = {node: k for k, node in enumerate(local.ids.tolist())}
        self.b, self.beside = b, [place.get(node, -1) for node in local.neighbour.tolist()]
        self.local, self.memory = local, np.empty((0, candidates.shape[1]))

    def act(self, x: Any, now: Any) -> Any:
        own = np.array([x[k] if k >= 0 else y for k, y in zip(self.beside, np.nan_to_num(now.x), strict=True)])
        return -0.01 * self.b * self.local.sums(own) - self.b * x

    def learn(self, x: Any, flow: Any, x_next: Any) -> None:
        pass

    def report(self) -> Any:
        return np.full((2, self.memory.shape[1]), np.nan)


def test_a_law_that_knows_nodes_by_their_ids_is_run_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hedgerow.orchestrator.ground.laws._keeps_contract", lambda *_: None)
    sweep = plan("paper7", "0:3", ["law=tests.orchestrator.runs.test_union:OwnIds"], "in-process")
    rows = answer(sweep, Chunk(0, (0, 1, 2)))
    assert isinstance(rows, list)
    for row in rows:
        assert row == {"setting": 0, "seed": row["seed"], **_row(_content(sweep, 0, row["seed"]))}


def test_a_law_that_fails_in_one_run_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = plan("paper7", "0:3", ["law=tests.orchestrator.runs.test_union:Picky"], "in-process")
    drawn = [resolve(sweep.settings[0].topology.model_copy(update={"seed": seed})) for seed in range(3)]
    monkeypatch.setattr(Picky, "LIMIT", np.median([np.nanmin(one.network.candidates) for one in drawn]))
    rows = answer(sweep, Chunk(0, (0, 1, 2)))
    assert isinstance(rows, list)
    assert sorted(row["verdict"] for row in rows) == ["unknown", "valid", "valid"]


class Picky:
    """Fails in a network with a candidate below a limit."""

    LIMIT = 0.0

    def __init__(self, b: float, candidates: Any) -> None:
        self.b, self.low = b, np.nanmin(candidates)
        self.memory = np.empty((0, candidates.shape[1]))

    def act(self, x: Any) -> Any:
        if self.low < self.LIMIT:
            raise RuntimeError("too low")
        return -self.b * x

    def learn(self, x: Any, flow: Any, x_next: Any) -> None:
        pass

    def report(self) -> Any:
        return np.full((2, self.memory.shape[1]), np.nan)


def test_json_numbers_of_rows_are_plain(tmp_path: Path) -> None:
    rows = answer(swept("drops", tmp_path, "0:2"), Chunk(0, (0, 1)))
    json.dumps(rows)
