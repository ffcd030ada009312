"""The plant sends state(t + 1) before the account of t, and its short way to encode states changes no byte."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.orchestrator.runs import reference
from hedgerow.plant.world import World
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.graph import Array
from hedgerow.topologies.load import load, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import encode_quiet_states, encode_state
from hedgerow.wire.message import Record, State, Telemetry
from tests.test_faults import faulty
from tests.tools.examples import examples
from tests.tools.networks import partitions, simulate


class Checked(World):
    """Compares the two ways to encode the states of a step."""

    def states(self) -> list[tuple[State | None, Record | None]]:
        sent = super().states()
        if (ready := self.ready_states) is not None:
            (x, tails), sizes = ready, [len(part.nodes) for part in self._parts]
            starts = encode_quiet_states(self.t, x, sizes)
            messages = [start + tail for start, tail in zip(starts, tails, strict=True)]
            assert messages == [encode_state(*state) for state, _ in sent if state]
            assert all(record is None for _, record in sent)
        return sent


class Early(Checked):
    """Begins t + 1 before the account of t, and looks ahead then, as the process of the plant does."""

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
        telemetry = self.account(report, used)
        if self.t < self.steps:
            self.look_ahead()
        return telemetry


class Changed(Early):
    """Adds a fault and ends another one after some steps, when the links of the next step are already planned."""

    def step(self, u: Array, report: Array, used: Sequence[Any]) -> Telemetry:
        telemetry = super().step(u, report, used)
        self.change()
        return telemetry

    def change(self) -> None:
        """Change the faults after steps 3 and 6, from the next step on."""
        if self.t == 4 and len(self.graph.node):
            self.faults.add([Effect(90, "drop", (0,), self.t + 1, self.t + 4)])
        if self.t == 7:
            # As the control of the plant: a crashed agent returns one step later, because it needs the messages before.
            returns = any(one.removes_agents for one in self.faults.effects if one.fault == 0)
            self.faults.end(0, self.t + 1 + returns)


class ChangedLate(World):
    """Changes the same faults, and never looks ahead."""

    def step(self, u: Array, report: Array, used: Sequence[Any]) -> Telemetry:
        telemetry = super().step(u, report, used)
        Changed.change(self)  # type: ignore[arg-type]  # it needs a World alone
        return telemetry


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


@given(topology=faulty(), data=st.data())
@settings(max_examples=examples(40), deadline=None)
def test_a_change_of_the_faults_discards_what_was_planned(topology: Topology, data: st.DataObject) -> None:
    shards = data.draw(partitions(len(topology.ids)))
    with mock.patch.object(reference, "World", ChangedLate):
        expected = simulate(topology, shards)
    with mock.patch.object(reference, "World", Changed):
        assert simulate(topology, shards).same_bits(expected)


def test_the_links_of_a_step_with_drops_are_planned_while_the_agents_work() -> None:
    planned: dict[int, bool] = {}

    class Counting(Early):
        def begin(self) -> None:
            super().begin()
            planned[self.t] = self.ready_states is not None

    topology = resolve(load("paper7"))
    drops = [{"kind": "drop", "link": list(edge), "probability": 0.3} for edge in topology.pairs]
    written = yaml.safe_load(to_yaml(topology)) | {"faults": drops, "steps": 50}
    with mock.patch.object(reference, "World", Counting):
        simulate(resolve(parse(json.dumps(written).encode(), "drops", Path())), [[k] for k in range(7)])
    assert len(planned) == 50
    assert all(planned.values())
