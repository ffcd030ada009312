"""Helpers for tests of imported networks."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest

from hedgerow.orchestrator.network import Network

ALL_READERS = "HEDGEROW_READERS"
"""environment variable: if it is set, a missing reader is a failure"""


def needs(package: str) -> Path:
    """Return the folder of a package; skip the test if it is not installed, or fail if all readers should be."""
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        _without(f"{package} is not installed")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def shipped(package: str, *inside: str) -> Path:
    """Return the path of a file that a package ships."""
    path = needs(package).joinpath(*inside)
    if not path.exists():
        _without(f"this release of {package} has no {path.name}")
    return path


def _without(reason: str) -> None:
    if os.environ.get(ALL_READERS):
        pytest.fail(reason)
    pytest.skip(reason)


def edges_of(net: Network) -> dict[frozenset[int | str], float]:
    """Return the weight of each edge by the ids of its ends."""
    network = net.topology.network
    weights = network.graph.weights
    return {
        frozenset((network.ids[i], network.ids[j])): 1.0 if weights is None else float(weights[e])
        for e, (i, j) in enumerate(network.graph.edges.tolist())
    }
