"""Sweeps with users' laws, faults, weights and tables: the rows of a batch equal those of single runs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.local import Local, Received
from hedgerow.orchestrator.experiments.compare import runs as compared
from hedgerow.orchestrator.experiments.sweep import runs as swept
from hedgerow.orchestrator.experiments.sweep.plan import Chunk, Plan, Setting
from hedgerow.orchestrator.ground import laws
from hedgerow.orchestrator.runs import batch
from hedgerow.topologies.law_choice import NAMES
from hedgerow.topologies.load import parse
from tests.agents.test_received_values import CHECKS


class Draws(Minimax):
    """Adds a number of numpy's generator to the input, from the seed of the run, the node and the step."""

    def __init__(self, b: float, candidates: Array, *, local: Local) -> None:
        super().__init__(b, candidates)
        self.local = local

    def act(self, x: Array, now: Received) -> Array:  # type: ignore[override]  # it asks
        drawn = [np.random.default_rng([self.local.seed, int(node), now.t]).normal() for node in self.local.ids]
        return super().act(x) + 0.01 * np.array(drawn)


class LooksUp(Minimax):
    """Keeps its offsets by node id, so in a batch, where ids repeat, it would find those of another run."""

    def __init__(self, b: float, candidates: Array, *, local: Local) -> None:
        super().__init__(b, candidates)
        drawn = dict(zip(local.ids.tolist(), local.draw(0).tolist(), strict=True))
        self.offset = np.array([drawn[node] for node in local.ids.tolist()])

    def act(self, x: Array) -> Array:
        return super().act(x) + 0.01 * self.offset


EXAMPLES = int(os.environ.get("HEDGEROW_BATCH_EXAMPLES", "8"))
USERS = [CHECKS, f"{__name__}:Draws", f"{__name__}:LooksUp"]
USERS += ["tests.tools.laws:Curious(weight=2)", "tests.tools.laws:LeastSquares"]
GRAPHS: list[dict[str, Any]] = [
    {
        "nodes": {1: {"b": 0.05}, 2: {"b": 0.08}, 3: {}, 4: {"candidates": [0.6, 0.3]}},
        "edges": [{"ends": [1, 2], "weight": 0.5}, {"ends": [2, 3], "weight": 1.5}, [3, 4], [1, 4]],
    },
    {"graph": {"kind": "random_tree", "nodes": 4}},
    {"nodes": [1, 2, 3, 4], "edges": [[1, 2], [2, 3], [3, 4], [1, 3]]},
]
FAULTS: list[dict[str, Any]] = [
    {"kind": "drop", "from": 1, "to": 2, "probability": 0.5},
    {"kind": "delay", "from": 2, "to": 1, "by": 2, "steps": [3, 9], "probability": 0.7},
    {"kind": "crash", "node": 3, "at": 6, "restart_after": 3},
    {"kind": "sensor", "node": 2, "steps": [4, 6]},
    {"kind": "actuator", "node": 1, "steps": [8, 10]},
    {"kind": "jump", "node": 2, "at": 7, "a": "random"},
]
DISTURBANCES: list[Any] = [
    {"kind": "white", "std": 0.3},
    {"kind": "samples", "file": "w1.csv", "header": "ids"},
    [{"kind": "ar1", "phi": 0.9, "std": 0.1}, {"kind": "confuse", "candidate": "random"}],
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = [f"{t % 3},0.5,-1,{0.1 * t}\n" for t in range(16)]
    for first in (0, 1):
        (tmp_path / f"w{first}.csv").write_text(",".join(f"{first + k}" for k in range(4)) + "\n" + "".join(rows))
    return tmp_path


@given(
    law=st.sampled_from([*NAMES, *USERS, *USERS]),
    graph=st.sampled_from(GRAPHS),
    faults=st.lists(st.sampled_from(FAULTS), max_size=3, unique_by=lambda one: one["kind"]),
    disturbance=st.sampled_from(DISTURBANCES),
    history=st.sampled_from([2, 1000]),
    listed=st.sampled_from([3, 9]),
)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_law_under_faults_gives_the_rows_of_single_runs(
    folder: Path, law: str, graph: Any, faults: Any, disturbance: Any, history: int, listed: int
) -> None:
    if "graph" in graph:  # each seed draws its own edges
        faults = [one for one in faults if "from" not in one]
        if "file" in disturbance:
            disturbance = {**disturbance, "file": "w0.csv"}
    defaults = {"x0": {"random": [-2, 2]}, "candidates": {"random": listed}, "disturbance": disturbance}
    text = {"name": "net", "b": 0.1, "steps": 14, "law": law, "history": history, "defaults": defaults}
    topology = laws.checked(
        parse(json.dumps({**text, **graph, "faults": faults}).encode(), "net.yaml", folder, ()), folder
    )
    plan = Plan(("law",), (Setting((law,), topology),), range(3), "in-process", folder)
    assert not batch.why_not(topology)
    for answer in (swept.answer, compared.answer):
        together = answer(plan, Chunk(0, (0, 1, 2)))
        alone = [answer(plan, Chunk(0, (seed,))) for seed in range(3)]
        assert isinstance(together, list), together
        assert together == [row for one in alone for row in one]  # type: ignore[union-attr]
