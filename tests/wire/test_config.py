"""The config of a remote process: one TOML text with the same data as the arrays of a forked process."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.agents.view import Peer, View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.plant.truth import Truth
from hedgerow.topologies.network import Group
from hedgerow.topologies.schema import Topology
from hedgerow.wire.config import Config
from tests.tools.networks import networks, partitions, read


def same(one: Any, other: Any) -> bool:
    """Return True if two configs are equal bit for bit, in type and shape."""
    if isinstance(one, np.ndarray):
        if object in (one.dtype, other.dtype):  # ids, some of the network's are names
            return bool(one.tolist() == other.tolist())
        return bool(one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes())
    if isinstance(one, View | Truth | Peer | Group):
        return all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def through_text(content: dict[str, Any]) -> dict[str, Any]:
    """Return the data after its way through a text."""
    text = Config("agent-3", "hedgerow/x", "tcp/bench:7447", "f00", content).to_toml()
    config = Config.parse(text, "here")
    assert (config.process, config.namespace, config.router, config.network) == (
        "agent-3",
        "hedgerow/x",
        "tcp/bench:7447",
        "f00",
    )
    return config.part


@given(st.data())
def test_views_and_truths_survive_the_text_to_the_bit(data: st.DataObject) -> None:
    topology: Topology = data.draw(networks())
    shards = data.draw(partitions(len(topology.ids)))
    for view in views_of(topology, shards):
        assert same(view, View.from_dict(through_text(view.to_dict())))
    truth = truth_of(topology, shards)
    assert same(truth, Truth.from_dict(through_text(truth.to_dict())))


def test_names_faults_and_samples_survive_it_too() -> None:
    topology = read(
        """
name: odd
b: 0.1
steps: 4
defaults: {candidates: [0.3, 0.6], a: 0.6, x0: 1}
nodes: {pump-1: {disturbance: {kind: samples, values: [0.1, -1e-300, 3, 4]}}, 2: {}, u: {}}
edges: [[pump-1, 2], [2, u]]
faults:
  - {kind: drop, link: [pump-1, 2], probability: 0.5}
  - {kind: crash, node: u, at: 1}
""",
    )
    shards = layout(topology, 2)
    for view in views_of(topology, shards):
        assert same(view, View.from_dict(through_text(view.to_dict())))
    truth = truth_of(topology, shards)
    assert same(truth, Truth.from_dict(through_text(truth.to_dict())))
