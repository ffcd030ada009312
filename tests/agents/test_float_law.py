"""The quiet step in floats has the same bits as the general path, with any events between quiet steps."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents import float_law
from hedgerow.agents.float_law import FloatLaw
from hedgerow.agents.law import Minimax
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import Peer, View
from hedgerow.orchestrator.ground.assignment import Layout, layout, truth_of, views_of
from hedgerow.plant.world import World
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import encode_input, encode_link, encode_state
from hedgerow.wire.message import Link
from tests.test_faults import faulty, harsh
from tests.tools.examples import examples
from tests.tools.networks import partitions, read, simulate


@contextmanager
def general_path() -> Iterator[None]:
    """All shards made meanwhile use numpy for every step."""
    with mock.patch.object(FloatLaw, "of", return_value=None):
        yield


@contextmanager
def patience(steps: int) -> Iterator[None]:
    """Let floats take over after this number of quiet steps."""
    with mock.patch.object(float_law, "STEPS_BEFORE", steps):
        yield


@contextmanager
def steps_in_floats() -> Iterator[list[int]]:
    """Give the steps before each one that floats made meanwhile."""
    made: list[int] = []
    step = FloatLaw.step

    def counted(self: FloatLaw, states: Any, links: Any, past: int) -> Any:
        made.append(past)
        return step(self, states, links, past)

    with mock.patch.object(FloatLaw, "step", counted):
        yield made


def check_same_bits(topology: Topology, shards: Layout, steps: int) -> None:
    """Compare a run with floats after this number of quiet steps with one of the general path alone."""
    with general_path():
        expected = simulate(topology, shards)
    with patience(steps):
        assert simulate(topology, shards).same_bits(expected)


@given(topology=faulty(steps=20), history=st.sampled_from([1, 2, 5, 100_000]), steps=st.integers(1, 4), data=st.data())
@settings(max_examples=examples(60), deadline=None)
def test_quiet_steps_give_the_bits_of_the_general_path_under_faults(
    topology: Topology, history: int, steps: int, data: st.DataObject
) -> None:
    topology = topology.model_copy(update={"history": history})
    check_same_bits(topology, data.draw(partitions(len(topology.ids))), steps)


@pytest.mark.parametrize("processes", [2, 3, 7])
@pytest.mark.parametrize("seed", range(6))
def test_long_runs_with_crashes_and_lost_messages_have_the_same_bits(seed: int, processes: int) -> None:
    topology = resolve(load("paper7", ["steps=60", "history=10", f"faults=[{', '.join(harsh(seed))}]"]))
    check_same_bits(topology, layout(topology, processes), 1)


def test_floats_make_almost_every_step_of_a_run_without_faults() -> None:
    topology = resolve(load("paper7", ["steps=30"]))
    with steps_in_floats() as made:
        simulate(topology, layout(topology, 7))
    assert len(made) == 7 * (30 - 1 - float_law.STEPS_BEFORE)


@given(
    values=st.lists(st.floats(width=64), min_size=12, max_size=12),
    b=st.sampled_from([0.1, 0.3]),
    models=st.lists(st.sampled_from([0.2, 0.5, 0.7, 0.9]), min_size=1, max_size=4),
)
def test_any_numbers_give_the_bits_of_the_law_or_are_passed_to_it(
    values: list[float], b: float, models: list[float]
) -> None:
    """NaN, infinities and numbers with overflowing squares are included."""
    view = View(
        shard=0,
        b=b,
        law="minimax",
        ids=np.array([1]),
        candidates=np.array(models)[:, None],
        row=np.array([0, 0]),
        column=np.array([1, 2]),
        peers=[Peer(1, np.array([0]), 2)],
        outside=np.array([2, 3]),
        history=0,
    )
    law, other = Minimax(b, view.candidates), Minimax(b, view.candidates)
    ours = FloatLaw.of(view, other)
    assert ours is not None
    x, u = np.zeros(1), np.zeros(1)
    for _ in range(float_law.STEPS_BEFORE):
        ours.enter_after(True, x, u, np.zeros((2, 1)))
    for one, two, now in zip(values[::3], values[1::3], values[2::3], strict=True):
        answer = ours.step([now], [Link(0, 0, bytes(16), struct.pack("<2d", one, two))], 0)
        if answer is None:
            break
        with np.errstate(all="ignore"):
            law.learn(x, np.array([(u[0] - one) + (u[0] - two)]), np.array([now]))
            x, u = np.array([now]), law.act(np.array([now]))
        assert np.array(ours.u).tobytes() == u.tobytes()
        assert np.array(ours.report).tobytes() == law.report().tobytes()
    ours.leave()
    assert other.memory.tobytes() == law.memory.tobytes()


@pytest.mark.parametrize("law", ["tests.tools.laws:Curious", "minimax"])
def test_only_the_law_of_the_paper_and_few_nodes_are_in_floats(law: str) -> None:
    topology = resolve(load("paper7", [f"law={law}"]))
    nodes = {"nodes": list(range(9)), "defaults": {"a": 0.4, "candidates": [0.4, 0.6]}}
    many = read(json.dumps({"name": "nine", "b": 0.1, "steps": 5, "law": law, "edges": [[0, 1], [7, 8]]} | nodes))
    views = [views_of(one, layout(one, processes)) for one, processes in ((topology, 7), (many, 1))]
    alone, together = (Shard(each[0])._floats is not None for each in views)
    assert (alone, together) == (law == "minimax", False)


@pytest.mark.parametrize("processes", [3, 7])
def test_messages_answered_without_numpy_are_those_of_the_general_path(processes: int) -> None:
    topology = resolve(load("paper7", ["steps=30"]))
    assignment = layout(topology, processes)
    views, world = views_of(topology, assignment), World(truth_of(topology, assignment))
    pairs = [(Shard(view), Shard(view)) for view in views]
    quietly = 0
    for _ in range(30):
        world.begin()
        given_rows, sent, inputs = world.states(), [], []
        for view, (one, other), (state, _) in zip(views, pairs, given_rows, strict=True):
            assert state is not None
            other.answer(state)
            general = [encode_link(link, other.peers[peers[0]].sends) for peers, link in other.send(state)]
            general.append(encode_input(state.t, other.u, other.report, other.used))
            answer = one.answer_quietly(encode_state(*state))
            if answer is None:
                one.answer(state)
            else:
                assert answer == general
                quietly += 1
            inputs.append(other.u)
            sent += [(view, peer, link) for peers, link in other.send(state) for peer in peers]
        for view, peer, link in sent:
            receiver = view.peers[peer].shard
            back = [other.shard for other in views[receiver].peers].index(view.shard)
            for shard in pairs[receiver]:
                shard.receive(back, link)
        nothing = np.zeros((2, len(topology.ids)))
        world.step(np.concatenate(inputs), nothing, [b""] * processes)
    assert quietly == processes * (30 - 1 - float_law.STEPS_BEFORE)


def test_a_state_of_another_step_or_with_more_in_it_is_left_to_the_general_path() -> None:
    forms = float_law.FloatForms(1, [None])
    message = encode_state(5, np.ones(1), b"")
    assert forms.states(message, 5) == [1.0]
    assert forms.states(message, 4) is forms.states(encode_state(5, np.ones(1), b"\x07"), 5) is None
    assert forms.states(b"\x00" + message[1:], 5) is None
