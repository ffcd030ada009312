"""Random networks over Zenoh, with faults at the boundaries of the run, equal the in-process reference."""

from __future__ import annotations

import contextlib
import os
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hedgerow.orchestrator.experiments.chaos import read, trial
from hedgerow.orchestrator.launch.fork_client import ForkClient
from tests.tools.verdicts import verdict_of

T = 8
BOUNDARIES = (0, 1, T - 2, T - 1, T, T + 3)
NETWORKS = int(os.environ.get("HEDGEROW_BOUNDARY_NETWORKS", "16"))
"""random networks; one of them has about as many faults as three small ones"""


def window(draw: random.Random) -> list[int]:
    first, stop = sorted(draw.sample(BOUNDARIES, 2))
    return [first, stop]


def fault(draw: random.Random, edges: list[list[int]], n: int) -> dict[str, Any]:
    node, edge = draw.randrange(n), draw.choice(edges)
    match draw.choice(("crash", "crash", "drop", "delay", "cut", "sensor", "actuator")):
        case "crash":
            at = draw.choice((0, 1, T - 2, T - 1))
            stop = draw.choice([one for one in BOUNDARIES if one > at])
            return {"kind": "crash", "node": node, "at": at, "restart_after": stop - at}
        case "drop":
            return {"kind": "drop", "link": edge, "steps": window(draw), "probability": draw.choice((0.5, 1.0))}
        case "delay":
            return {
                "kind": "delay",
                "from": edge[0],
                "to": edge[1],
                "by": draw.choice((1, 2, T)),
                "steps": window(draw),
            }
        case "cut":
            return {"kind": "cut", "edge": edge, "steps": window(draw)}
        case kind:
            return {"kind": kind, "node": node, "steps": window(draw)}


@pytest.fixture(scope="module")
def fork_client() -> Iterator[ForkClient]:
    """Provide one fork server for all networks: a new one takes longer than a run."""
    with contextlib.closing(ForkClient()) as fork_client:
        yield fork_client


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(NETWORKS))
def test_faults_at_the_boundaries_of_a_run_give_the_reference(seed: int, here: Path, fork_client: ForkClient) -> None:
    draw = random.Random(seed)
    n = draw.randint(2, 5)
    edges = [[draw.randrange(node), node] for node in range(1, n)]
    topology: dict[str, Any] = {
        "name": "model",
        "b": 0.1,
        "steps": T,
        "seed": seed,
        "nodes": list(range(n)),
        "edges": edges,
    }
    topology["defaults"] = {"x0": 3.0, "disturbance": {"kind": "white", "std": 0.2}}
    topology["faults"] = [fault(draw, edges, n) for _ in range(draw.randint(1, 8))]
    topology["processes"] = draw.randint(1, n)
    assert trial(read(topology), here / "run", fork_client) == ""
    verdict = verdict_of(here / "run")
    assert verdict["verdict"] != "INVALID"
    assert verdict["checks"]["reference"]["ok"]
