"""Rows of telemetry in shared memory: whole, once and in order, whatever the network loses."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.wire.codec import encode_place, encode_telemetry, join, kind_of
from hedgerow.wire.message import Kind, MessageError, Telemetry
from hedgerow.wire.shared_rows import SharedRows, close, create, open_shared
from hedgerow.wire.stream import Inbox, Outbox

N, E = 3, 2
ROW_BYTES = 16 + 40 * N + 5 * E
AHEAD = 2


def row(t: int, whole: bool = False) -> tuple[object, ...]:
    numbers = np.arange(5.0 * N).reshape(5, N) + t
    flags = [np.full(k, t % 7, dtype=np.uint8) for k in (E, 2 * E, 2 * E)]
    return encode_telemetry(Telemetry(t, numbers[0], numbers[1], numbers[2], numbers[3:], *flags), whole)


@pytest.fixture
def memory() -> Iterator[tuple[SharedRows, str]]:
    shared, path = create(ROW_BYTES, AHEAD)
    assert shared is not None
    yield shared, path
    close(path)


def test_another_opening_reads_what_was_written(memory: tuple[SharedRows, str]) -> None:
    reader, path = memory
    writer = open_shared(path, ROW_BYTES)
    assert writer is not None
    for t in range(3 * writer.rows):
        parts = row(t, whole=t % 2 == 0)
        message = writer.write(t, parts)  # type: ignore[arg-type]
        assert kind_of(message) == Kind.PLACE
        assert reader.read(message) == join(parts)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("start", "length"),
    [(-ROW_BYTES, 16), (0, 0), (0, ROW_BYTES + 1), (1, 16), (10 * ROW_BYTES, 16), (2**62, 16), (0, 2**62)],
)
def test_a_place_outside_of_the_memory_is_refused(memory: tuple[SharedRows, str], start: int, length: int) -> None:
    with pytest.raises(MessageError):
        memory[0].read(encode_place(0, start, length))


@pytest.mark.parametrize("path", ["", "/etc/passwd", "/proc/self/fd/0", "/proc/1/fd/999999", "../x"])
def test_memory_that_cannot_be_opened_is_none(path: str) -> None:
    assert open_shared(path, ROW_BYTES) is None


def test_a_file_that_is_too_small_is_none(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"x")
    descriptor = os.open(tmp_path / "small", os.O_RDWR)
    try:
        assert open_shared(f"/proc/{os.getpid()}/fd/{descriptor}", ROW_BYTES) is None
    finally:
        os.close(descriptor)


def test_a_place_without_memory_is_refused() -> None:
    inbox, sent = Inbox(), list[bytes]()
    Outbox(sent.append).send(encode_place(0, 0, 16))
    assert inbox.put(sent[0]) == []
    assert (inbox.refused, inbox.last) == (1, -1)


@given(actions=st.lists(st.sampled_from(["row", "lost row", "event", "repeat", "seen", "lost seen"]), max_size=60))
def test_every_row_arrives_whole_once_and_in_order(actions: list[str]) -> None:
    shared, path = create(ROW_BYTES, AHEAD)
    assert shared is not None
    try:
        inbox, losing = Inbox(shared.read), False

        def put(whole: bytes) -> None:
            if not losing:
                inbox.put(whole)

        outbox, sent, got = Outbox(put), list[bytes](), list[bytes]()
        for t, action in enumerate(actions):
            losing = action.startswith("lost")
            match action.split()[-1]:
                case "row":  # as the plant sends it
                    parts = row(t)
                    sent.append(join(parts))  # type: ignore[arg-type]
                    if len(outbox) < shared.rows:
                        outbox.send(shared.write(t, parts))  # type: ignore[arg-type]
                    else:
                        outbox.send(*parts)  # type: ignore[arg-type]
                case "event":
                    sent.append(b"e" * 20)
                    outbox.send(sent[-1])
                case "repeat":
                    outbox.repeat()
                case "seen" if not losing:
                    outbox.seen(inbox.last)
                    got += inbox.drain()
        losing = False
        outbox.repeat()
        assert got + inbox.drain() == sent
    finally:
        close(path)
