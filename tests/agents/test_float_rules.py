"""The rules of the laws in floats: the same bits as the laws themselves, under any faults and with any numbers."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents import float_law
from hedgerow.agents.float_law import FloatLaw
from hedgerow.agents.float_rules import _RULES
from hedgerow.agents.loading import new_law
from hedgerow.agents.local import Received
from hedgerow.agents.view import Peer, View
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology
from hedgerow.wire.message import Link
from tests.agents.test_float_law import check_same_bits, general_path, steps_in_floats
from tests.test_faults import faulty, harsh
from tests.tools.examples import examples
from tests.tools.networks import partitions, simulate

LAWS = (
    *("forgetting(decay=0.9)", "hysteresis(h=0.3)", "set-membership", "centred", "notch", "either(ratio=0.1)"),
    *("rls(eps=0.001)", "robust(theta=0.4)", "bayes(sigma=0.2)", "thompson(sigma=0.2)"),
)


def test_every_law_with_a_rule_is_tried() -> None:
    names = {law.partition("(")[0] for law in LAWS}
    assert {rule.__module__.rpartition(".")[2].replace("_", "-") for rule in _RULES} == names


@given(topology=faulty(steps=20), law=st.sampled_from(LAWS), steps=st.integers(1, 4), data=st.data())
@settings(max_examples=examples(60), deadline=None)
def test_quiet_steps_give_the_bits_of_the_general_path_under_faults(
    topology: Topology, law: str, steps: int, data: st.DataObject
) -> None:
    topology = topology.model_copy(update={"law": law})
    check_same_bits(topology, data.draw(partitions(len(topology.ids))), steps)


@pytest.mark.parametrize("law", LAWS)
def test_long_runs_with_crashes_and_lost_messages_have_the_same_bits(law: str) -> None:
    topology = resolve(load("paper7", ["steps=60", "history=10", f"law={law}", f"faults=[{', '.join(harsh(1))}]"]))
    check_same_bits(topology, layout(topology, 7), 1)


@pytest.mark.parametrize("law", LAWS)
def test_floats_make_almost_every_step_of_a_run_without_faults(law: str) -> None:
    topology = resolve(load("paper7", ["steps=30", f"law={law}"]))
    with general_path():
        expected = simulate(topology, layout(topology, 7))
    with steps_in_floats() as made:
        assert simulate(topology, layout(topology, 7)).same_bits(expected)
    assert len(made) == 7 * (30 - 1 - float_law.STEPS_BEFORE)


@given(
    law=st.sampled_from(LAWS),
    values=st.lists(st.floats(width=64), min_size=18, max_size=18),
    models=st.lists(st.sampled_from([0.2, 0.5, 0.7, 0.9]), min_size=1, max_size=4),
)
@settings(max_examples=examples(200), deadline=None)
def test_any_numbers_give_the_bits_of_the_law_or_are_left_to_it(
    law: str, values: list[float], models: list[float]
) -> None:
    """NaN, infinities and numbers with overflowing squares are included."""
    view = View(
        shard=0,
        b=0.1,
        law=law,
        ids=np.array([1]),
        candidates=np.array(models)[:, None],
        row=np.array([0]),
        column=np.array([1]),
        peers=[Peer(1, np.array([0]), 1)],
        outside=np.array([2]),
        history=0,
        seed=5,
    )
    expected, other = new_law(view), new_law(view)
    ours = FloatLaw.of(view, other)
    assert ours is not None
    x, u = np.zeros(1), np.zeros(1)
    for _ in range(float_law.STEPS_BEFORE):
        ours.enter_after(True, x, u, np.zeros((2, 1)))
    asked = {"forgetting": 0, "notch": 1, "either": 1, "thompson": 2}.get(law.partition("(")[0], 0)

    def received(t: int) -> Received:
        return Received(t, np.ones(1, dtype=bool), np.zeros(1), np.zeros(1), np.full(1, t))

    for t, (one, now) in enumerate(zip(values[::2], values[1::2], strict=True)):
        answer = ours.step([now], [Link(0, 0, bytes(8), struct.pack("<d", one))], t)
        if answer is None:
            break
        with np.errstate(all="ignore"):
            more = [received(t)] if asked == 1 else []
            expected.learn(x, np.array([u[0] - one]), np.array([now]), *more)
            x = np.array([now])
            u = np.asarray(expected.act(x, *([received(t + 1)] if asked == 2 else [])))
        assert np.array(ours.u).tobytes() == u.tobytes()
        assert np.array(ours.report).tobytes() == np.asarray(expected.report()).tobytes()
    with np.errstate(all="ignore"):  # as in every process of a run
        ours.leave()
    assert np.asarray(other.memory).tobytes() == np.asarray(expected.memory).tobytes()
