"""Steps with dropped and late messages in floats have the bits of the general path, and so have their messages."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.samples import Samples
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.plant.world import World
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import decode_state, encode_state
from hedgerow.wire.message import ALL_UP, Span
from tests.agents.test_float_law import check_same_bits, general_path
from tests.tools.networks import networks, partitions, simulate
from tests.tools.schedules import with_faults

LINKS = ("[1, 2]", "[2, 3]", "[2, 4]", "[3, 5]", "[4, 6]", "[4, 7]")


def dropping(*more: str, steps: int = 60, probability: float = 0.3) -> Topology:
    """Return paper7 in which every message is lost with a probability, and more faults."""
    drops = [f"{{kind: drop, link: {link}, probability: {probability}}}" for link in LINKS]
    return resolve(load("paper7", [f"steps={steps}", f"faults=[{', '.join([*drops, *more])}]"]))


@st.composite
def late_and_lost(draw: st.DrawFn) -> Topology:
    """Return a network with drops and delays on every link, and now and then a fault that needs the general path."""
    topology = draw(networks(most=7, steps=30))
    lots = random.Random(draw(st.integers(0, 2**32)))
    faults: list[dict[str, Any]] = []
    for link in topology.pairs:
        start = lots.randrange(25)
        window = {"link": list(link), "steps": [start, start + lots.randint(1, 20)]}
        faults.append({"kind": "drop", "link": list(link), "probability": lots.choice([0.1, 0.3, 0.7])})
        if lots.random() < 0.3:
            faults.append({"kind": "delay", "by": lots.randint(1, 3), **window})
        if lots.random() < 0.1:
            faults.append({"kind": "cut", "edge": window["link"], "steps": [start, start + 2]})
    if lots.random() < 0.3:
        at = lots.randrange(10, 25)
        faults.append({"kind": "sensor", "node": topology.ids[0], "steps": [at, at + 1]})
    return with_faults(topology, faults, backfill=True)


@given(topology=late_and_lost(), steps=st.integers(1, 4), data=st.data())
@settings(max_examples=40, deadline=None)
def test_steps_with_gaps_give_the_bits_of_the_general_path(topology: Topology, steps: int, data: st.DataObject) -> None:
    check_same_bits(topology, data.draw(partitions(len(topology.ids))), steps)


@given(topology=late_and_lost(), data=st.data())
@settings(max_examples=40, deadline=None)
def test_samples_learned_onward_are_those_learned_from_a_mark(topology: Topology, data: st.DataObject) -> None:
    shards = data.draw(partitions(len(topology.ids)))
    with general_path():
        onward = simulate(topology, shards)
        with mock.patch.object(Samples, "_starts_here", return_value=False):
            assert simulate(topology, shards).same_bits(onward)


@pytest.mark.parametrize("processes", [1, 7])
def test_floats_make_almost_every_step_with_dropped_messages(processes: int) -> None:
    topology, made = dropping(steps=100), 0
    step = Shard._close

    def counted(self: Shard, *given: Any) -> None:
        nonlocal made
        made += 1
        step(self, *given)

    with mock.patch.object(Shard, "_close", counted):
        simulate(topology, layout(topology, processes))
    assert made < 20 * processes


@pytest.mark.parametrize("processes", [2, 7])
def test_a_link_that_is_down_for_long_has_the_bits_of_the_general_path(processes: int) -> None:
    """More samples wait than floats keep, and then a crash and a cut edge meet samples that wait."""
    more = (
        "{kind: drop, link: [2, 3], steps: [20, 70]}",
        "{kind: cut, edge: [4, 6], steps: [90, 93]}",
        "{kind: crash, node: 4, at: 100, restart_after: 5}",
    )
    topology = dropping(*more, steps=130)
    check_same_bits(topology, layout(topology, processes), 2)


def both_ways(processes: int) -> tuple[list[View], World, list[Shard], list[Shard]]:
    """Return the views and the plant of a network with lost and late messages; and its shards, twice.

    The second shards make every step by the general path.
    """
    topology = dropping("{kind: delay, link: [2, 3], by: 2, steps: [20, 40]}")
    assignment = layout(topology, processes)
    views, world = views_of(topology, assignment), World(truth_of(topology, assignment))
    with general_path():
        others = [Shard(view) for view in views]
    return views, world, [Shard(view) for view in views], others


def deliver(sent: Sequence[tuple[View, int, bytes]], views: Sequence[View], *networks: Sequence[Shard]) -> None:
    """Give each message, with the view of its sender and the receiving peer there, to the shards of each network."""
    for view, peer, link in sent:
        receiver = view.peers[peer].shard
        back = [other.shard for other in views[receiver].peers].index(view.shard)
        for shards in networks:
            shards[receiver].receive_message(back, link)


@pytest.mark.parametrize("processes", [3, 7])
def test_messages_of_steps_with_gaps_are_those_of_the_general_path(processes: int) -> None:
    views, world, ours, others = both_ways(processes)
    in_floats = 0
    for _ in range(60):
        world.begin()
        sent, inputs = [], []
        for view, one, other, (state, _) in zip(views, ours, others, world.states(), strict=True):
            assert state is not None
            message = encode_state(*state)
            own = decode_state(message, one.k, one.m)
            one.step(own)
            in_floats += one._behind
            other.step(own)
            links, answer = one.messages(own)
            assert (links, answer) == other.messages(own)
            sent += [(view, peer, link) for peers, link in links for peer in peers]
            inputs.append(answer)
        deliver(sent, views, ours, others)
        report = np.concatenate([one.report for one in ours], axis=1)
        world.step(np.concatenate([one.u for one in ours]), report, [one.used for one in ours])
    assert in_floats > 30 * processes


@pytest.mark.parametrize("processes", [3, 7])
def test_answers_with_gaps_are_those_of_the_general_path(processes: int) -> None:
    """The bytes of a state message give the bytes of the answer, whichever way makes it."""
    views, world, ours, others = both_ways(processes)
    at_once = 0
    for _ in range(60):
        world.begin()
        sent = []
        for view, one, other, (state, _) in zip(views, ours, others, world.states(), strict=True):
            assert state is not None
            message = encode_state(*state)
            own = decode_state(message, one.k, one.m)
            if (answer := one.answer_with_gaps(message)) is None:
                one.step(own)
                answer = one.messages(own)
            else:
                at_once += 1
            other.step(own)
            assert answer == other.messages(own)
            assert one.answer_with_gaps(message) is None, "the same state again"
            sent += [(view, peer, link) for peers, link in answer[0] for peer in peers]
        deliver(sent, views, ours, others)
        report = np.concatenate([one.report for one in others], axis=1)
        world.step(np.concatenate([one.u for one in others]), report, [one.used for one in others])
    assert at_once > 30 * processes


def test_malformed_states_are_left_to_the_general_path() -> None:
    topology = dropping()
    shard = Shard(views_of(topology, layout(topology, 7))[3])
    form, m = shard._forms, shard.m
    flags, spans = bytes([ALL_UP] * m), [Span(0, 0, 1, 0, 1)]
    good = encode_state(5, np.ones(1), flags, spans)
    assert form.state(good, 5, m) == ([1.0], flags, spans)
    assert form.state(encode_state(5, np.ones(1), b""), 5, m) == ([1.0], b"", [])
    for bad in (b"", good[:20], good[:-1], good + b"0", good[:-21], encode_state(5, np.ones(2), flags)):
        assert form.state(bad, 5, m) is None
    assert form.state(good, 6, m) is None
    assert form.state(encode_state(5, np.ones(1), flags, [Span(m, 0, 1, 0, 1)]), 5, m) is None
