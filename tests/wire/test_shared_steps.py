"""States and inputs in shared memory: the same bytes as in messages, or a refusal, and a fallback to messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.wire.codec import encode_input, encode_place, encode_state, kind_of, step_of
from hedgerow.wire.message import Kind, MessageError
from hedgerow.wire.shared_rows import close
from hedgerow.wire.shared_steps import PLANT, SharedSteps, create_steps, open_steps

K, M = 5, 8


def state_of(t: int, flags: bytes = b"") -> bytes:
    return encode_state(t, np.arange(K) + 0.5 * t, flags)


def input_of(t: int) -> bytes:
    return encode_input(t, np.arange(K) - t / 3, np.full((2, K), float(t)), b"\x03" * M)


@pytest.fixture
def path() -> Iterator[str]:
    path = create_steps(K, M)
    assert path
    yield path
    close(path)


@pytest.fixture
def ends(path: str) -> tuple[SharedSteps, SharedSteps]:
    plant, agent = open_steps(path, K, M, PLANT, plant=True), open_steps(path, K, M, 1)
    assert plant is not None
    assert agent is not None
    return plant, agent


def test_both_directions_give_the_bytes_of_the_messages(ends: tuple[SharedSteps, SharedSteps]) -> None:
    plant, agent = ends
    for t in range(6):
        whole = state_of(t, b"\x07" * M if t % 2 else b"")
        place = plant.write(t, whole)
        assert kind_of(place) == Kind.PLACE
        assert agent.copy(place) == whole
        assert plant.view(agent.write(t, input_of(t))) == input_of(t)


def test_a_repetition_leaves_the_row_as_it_is(ends: tuple[SharedSteps, SharedSteps]) -> None:
    plant, agent = ends
    place = plant.write(3, state_of(3))
    assert plant.write(3, state_of(4)) == place
    assert agent.copy(place) == state_of(3)


@given(steps=st.integers(0, 9), behind=st.integers(0, 9))
def test_a_late_reader_gets_the_right_step_or_is_refused(steps: int, behind: int) -> None:
    path = create_steps(K, M)
    try:
        plant, agent = open_steps(path, K, M, PLANT, plant=True), open_steps(path, K, M, 1)
        assert plant is not None
        assert agent is not None
        places = [plant.write(t, state_of(t)) for t in range(steps + 1)]
        t = max(0, steps - behind)
        if steps - t < 2:
            assert agent.copy(places[t]) == state_of(t)
        else:
            with pytest.raises(MessageError):
                agent.copy(places[t])
    finally:
        close(path)


def test_a_half_written_row_is_refused(ends: tuple[SharedSteps, SharedSteps]) -> None:
    plant, agent = ends
    place = plant.write(0, state_of(0))
    start, length = np.frombuffer(place, "<i8", 2, 16).tolist()

    class Message(bytes):
        """Bytes that are read in two parts; the reader looks between the two."""

        def __getitem__(self, part: Any) -> Any:
            with pytest.raises(MessageError):
                agent.copy(encode_place(2, start, length))
            with pytest.raises(MessageError):
                agent.copy(place)
            return super().__getitem__(part)

    assert agent.copy(plant.write(2, Message(state_of(2)))) == state_of(2)


@pytest.mark.parametrize(("start", "length"), [(0, 16), (64, 10**6), (2**40, 16), (-64, 16), (64, 8), (65, 16)])
def test_a_place_where_nothing_is_written_is_refused(
    ends: tuple[SharedSteps, SharedSteps], start: int, length: int
) -> None:
    for end in ends:
        with pytest.raises(MessageError):
            end.view(encode_place(1, start, length))


def test_each_end_knows_if_the_other_has_the_memory(path: str) -> None:
    plant = open_steps(path, K, M, PLANT, plant=True)
    assert plant is not None
    assert not plant.has(1)
    first = open_steps(path, K, M, 1)
    assert first is not None
    assert first.has(PLANT)
    assert plant.has(1)
    assert not plant.has(2)  # the next life, until it opens the memory too
    open_steps(path, K, M, 2)
    assert plant.has(2)


def test_a_message_that_does_not_fit_travels_whole(ends: tuple[SharedSteps, SharedSteps]) -> None:
    long = state_of(1) + bytes(M + 20)
    assert ends[0].write(1, long) is long


def test_memory_of_another_shard_or_none_is_not_opened(path: str) -> None:
    assert open_steps(path, 1000 * K, M, PLANT, plant=True) is None
    assert open_steps("/etc/passwd", K, M, 1) is None
    assert open_steps("", K, M, 1) is None


def test_the_step_of_a_message_is_in_its_header() -> None:
    assert step_of(state_of(12)) == 12
