"""The inputs of a step: the same numbers whatever form the messages have and in whatever order they arrive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.plant import inputs as module
from hedgerow.plant.inputs import Inputs
from hedgerow.wire.codec import encode_input
from hedgerow.wire.message import REPORT_ROWS, MessageError

T = 7
BITS = st.integers(0, 2**64 - 1)


@st.composite
def answers(draw: st.DrawFn) -> tuple[list[int], list[int], list[bytes]]:
    """Nodes and incidences by shard, and the message of each; empty for a silent one."""
    sizes = draw(st.lists(st.integers(1, 4), min_size=1, max_size=6))
    incidences = [draw(st.integers(1, 5)) for _ in sizes]
    messages = []
    for k, m in zip(sizes, incidences, strict=True):
        count = (1 + REPORT_ROWS) * k
        values = np.array(draw(st.lists(BITS, min_size=count, max_size=count)), np.uint64).view(float)
        used = draw(st.sampled_from([b"", bytes(m), None]))
        messages.append(b"" if used is None else encode_input(T, values[:k], values[k:], used))
    return sizes, incidences, messages


def read(
    sizes: Sequence[int], incidences: Sequence[int], messages: Sequence[bytes], order: Sequence[int]
) -> list[bytes]:
    """Return all that was taken, as bytes: u, the reports and the flags."""
    inputs = Inputs(sizes, incidences)
    inputs.begin(T)
    for p in order:
        assert not messages[p] or inputs.take(p, messages[p])
    u = inputs.u()
    inputs.begin(T + 1)
    report, used = inputs.rest()
    assert u.shape == (sum(sizes),)
    assert report.shape == (REPORT_ROWS, sum(sizes))
    return [u.tobytes(), report.tobytes(), *map(bytes, used if any(used) else ())]


@given(answers(), st.randoms(use_true_random=False))
def test_every_path_and_order_gives_the_same_bits(
    given_: tuple[list[int], list[int], list[bytes]], random: st.DataObject
) -> None:
    sizes, incidences, messages = given_
    order = list(range(len(sizes)))
    together = read(sizes, incidences, messages, order)
    random.shuffle(order)  # type: ignore[attr-defined]
    assert read(sizes, incidences, messages, order) == together
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "TOGETHER", 0)
        assert read(sizes, incidences, messages, order) == together


def test_a_silent_shard_has_no_numbers_and_took_nothing_in() -> None:
    inputs = Inputs([1, 1], [2, 3])
    inputs.begin(0)
    assert inputs.take(0, encode_input(0, np.ones(1), np.ones((2, 1)), b""))
    np.testing.assert_array_equal(inputs.u(), [1, np.nan])
    report, used = inputs.rest()
    np.testing.assert_array_equal(report, [[1, np.nan], [1, np.nan]])
    assert [bytes(one) for one in used] == [b"", bytes(3)]


def test_an_input_of_another_step_is_not_taken() -> None:
    inputs = Inputs([1], [2])
    inputs.begin(3)
    for t in (2, 4):
        assert not inputs.take(0, encode_input(t, np.ones(1), np.ones((2, 1)), b""))
    assert np.isnan(inputs.u()).all()


@given(st.binary(max_size=60))
def test_other_bytes_are_refused(message: bytes) -> None:
    inputs = Inputs([1], [2])
    inputs.begin(3)
    with pytest.raises(MessageError):
        inputs.take(0, b"\x00" + message)
