"""The faults of a step do not depend on the number of steps that are computed at once."""

from __future__ import annotations

from unittest import mock

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.plant import faults as module
from hedgerow.plant.faults import ActiveFaults, Faults
from hedgerow.topologies.faults import effects
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty

FIELDS = ("lost", "late", "cut", "blind", "mute")


def faults_of(topology: Topology) -> Faults:
    return Faults(effects(topology.faults, topology), topology.graph, topology.ids, topology.seed)


def same(one: ActiveFaults | None, other: ActiveFaults | None) -> bool:
    if one is None or other is None:
        return one is other
    pairs = [(getattr(one, field), getattr(other, field)) for field in FIELDS]
    return all((a is None) == (b is None) and (a is None or np.array_equal(a, b)) for a, b in pairs)


@given(topology=faulty(), order=st.lists(st.integers(0, 20), min_size=1, max_size=20))
@settings(max_examples=50, deadline=None)
def test_steps_in_any_order_and_blocks_of_any_size_have_the_same_faults(topology: Topology, order: list[int]) -> None:
    together, alone = faults_of(topology), faults_of(topology)
    for t in order:
        found = together.at(t)
        with mock.patch.object(module, "BLOCK", 1):
            assert same(found, alone.at(t))
