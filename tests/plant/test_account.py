"""The plant sends state(t + 1) before the account of t, and its short way to encode states changes no byte."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from unittest import mock

from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.runs import reference
from hedgerow.plant.world import World
from hedgerow.topologies.graph import Array
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import encode_quiet_states, encode_state
from hedgerow.wire.message import Record, State, Telemetry
from tests.test_faults import faulty
from tests.tools.examples import examples
from tests.tools.networks import partitions, simulate


class Early(World):
    """Begins t + 1 before the account of t, as the process of the plant does."""

    began = False

    def begin(self) -> None:
        if not self.began:
            super().begin()
        self.began = False

    def step(self, u: Array, report: Array, used: Sequence[Any]) -> Telemetry:
        self.advance(u)
        if self.t < self.steps:
            self.begin()
            self.began = True
        return self.account(report, used)


class Checked(World):
    """Compares the two ways to encode the states of a step."""

    def states(self) -> list[tuple[State | None, Record | None]]:
        sent = super().states()
        if (x := self.quiet_states) is not None:
            sizes = [len(part.nodes) for part in self._parts]
            assert encode_quiet_states(self.t, x, sizes) == [encode_state(*state) for state, _ in sent if state]
            assert all(record is None for _, record in sent)
        return sent


@given(topology=faulty(), history=st.sampled_from([1, 5, 100_000]), data=st.data())
@settings(max_examples=examples(60), deadline=None)
def test_neither_the_order_nor_the_short_way_changes_a_bit(
    topology: Topology, history: int, data: st.DataObject
) -> None:
    topology = topology.model_copy(update={"history": history})
    shards = data.draw(partitions(len(topology.ids)))
    expected = simulate(topology, shards)
    for world in (Early, Checked):
        with mock.patch.object(reference, "World", world):
            assert simulate(topology, shards).same_bits(expected)
