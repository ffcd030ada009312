"""Messages arrive as they were sent, bit for bit; anything else is refused with a message."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hedgerow.wire import codec
from hedgerow.wire.message import (
    REPORT_ROWS,
    TAKEN,
    Array,
    End,
    Flags,
    Kind,
    Link,
    MessageError,
    Record,
    RoundTripTimes,
    Span,
    State,
    Telemetry,
)
from tests.tools.examples import examples

BITS = st.integers(0, 2**64 - 1)
"""Any eight bytes are a float: NaNs with payloads, -0.0, infinities and subnormals among them."""
STEPS = st.integers(0, 2**63 - 1)
U32 = st.integers(0, 2**32 - 1)


class Message(NamedTuple):
    """A message, its sender's fields, and how its receiver reads it."""

    raw: bytes
    sent: tuple[Any, ...]
    read: Callable[[bytes], tuple[Any, ...]]
    fits: Callable[[int], bool] | None = None
    """returns True if this length is possible; None for a fixed length"""


def either(size: int, more: int) -> Callable[[int], bool]:
    """Accept a message of this length, or with `more` bytes."""
    return lambda found: found in (size, size + more)


def rows(size: int, row: int, least: int = 0) -> Callable[[int], bool]:
    """Accept a message of this length, with any number of rows after it, at least `least`."""
    return lambda found: found == size or (row > 0 and (found - size) % row == 0 and found >= size + least * row)


def state_fits(size: int, n: int, m: int) -> bool:
    """Without flags, or with flags and any number of spans."""
    return size == 16 + 8 * n or rows(16 + 8 * n + m, 20)(size)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Any message between processes that share n nodes and e edges (or incidences)."""
    n, e, t = draw(st.integers(0, 5)), draw(st.integers(0, 6)), draw(STEPS)
    first = min(t, 2**62)

    def array(*shape: int) -> Array:
        size = int(np.prod(shape))
        values = np.array(draw(st.lists(BITS, min_size=size, max_size=size)), np.uint64).view("<f8")
        return values.reshape(shape)

    def flags(*shape: int) -> Flags:
        size = int(np.prod(shape))
        return np.frombuffer(draw(st.binary(min_size=size, max_size=size)), np.uint8).reshape(shape)

    def state() -> Message:
        spans = st.builds(Span, st.integers(0, e - 1), U32, U32, U32, U32) if e else st.nothing()
        used_flags = flags(e).tobytes() if draw(st.booleans()) else b""
        sent = State(t, array(n), used_flags, draw(st.lists(spans, max_size=3)) if used_flags else [])
        raw = codec.encode_state(*sent)
        return Message(raw, sent, lambda m: codec.decode_state(m, n, e), lambda size: state_fits(size, n, e))

    def record() -> Message:
        degrees = draw(st.lists(st.integers(0, 3), min_size=n, max_size=n))
        back = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)), np.bool_)
        r, m = int(back.sum()), int(np.dot(back, degrees))
        steps = draw(st.integers(0, 4)) if r else 0
        sent = Record(first + steps, back, first, array(steps, r), array(steps, r), flags(steps, m))
        return Message(
            codec.encode_record(sent), sent, lambda m: codec.decode_record(m, degrees), rows(24 + n, 16 * r + m)
        )

    def input_() -> Message:
        u, report, used = array(n), array(REPORT_ROWS, n), flags(e if draw(st.booleans()) else 0)
        raw = codec.encode_input(t, u, report, used)
        read = (t, u, *report, used)
        return Message(raw, read, lambda m: codec.decode_input(m, n, e), either(16 + 24 * n, e))

    def link() -> Message:
        steps, boundary = draw(st.integers(1, 4)), n + 1
        x, u = array(steps, boundary).tobytes(), array(steps, boundary).tobytes()
        sent = Link(first + steps - 1 + draw(st.integers(0, 3)), first, x, u)
        raw = codec.encode_link(sent, boundary)
        return Message(raw, sent, lambda m: codec.decode_link(m, boundary), rows(24, 16 * boundary, least=1))

    def telemetry() -> Message:
        x, u, w, report = array(n), array(n), array(n), array(REPORT_ROWS, n)
        whole = draw(st.booleans())
        everything = (np.full(c, bit, np.uint8) for c, bit in ((e, 1), (2 * e, 1), (2 * e, TAKEN)))
        bits = everything if whole else (flags(e), flags(2 * e), flags(2 * e))
        sent = Telemetry(t, x, u, w, report, *bits)
        raw = codec.join(codec.encode_telemetry(sent, whole))
        return Message(raw, sent, lambda m: codec.decode_telemetry(m, n, e), either(16 + 40 * n, 5 * e))

    def round_trips() -> Message:
        sent = RoundTripTimes(t, array(draw(st.integers(1, 4)), n + 1))
        return Message(
            codec.encode_round_trips(sent),
            sent,
            lambda m: codec.decode_round_trips(m, n + 1),
            rows(16, 8 * (n + 1), least=1),
        )

    def end() -> Message:
        sent = End(t, array(n), draw(st.floats(0, 1e9)), draw(STEPS))
        return Message(codec.encode_end(sent), sent, lambda m: codec.decode_end(m, n))

    def seen() -> Message:
        return Message(codec.encode_seen(t), (t,), lambda m: (codec.decode_seen(m),))

    message: Message = draw(st.sampled_from([state, record, input_, link, telemetry, round_trips, end, seen]))()
    return message


def same(sent: Any, arrived: Any) -> bool:
    """Check every bit and the shape; the receiver may leave these fields in bytes."""
    if isinstance(arrived, bytes | memoryview):
        return (sent if isinstance(sent, bytes) else np.asarray(sent).tobytes()) == bytes(arrived)
    if isinstance(arrived, np.ndarray):
        return np.shape(sent) == arrived.shape and np.asarray(sent).tobytes() == arrived.tobytes()
    return sent == arrived or (not sent and not arrived)


@given(messages())
def test_a_sent_message_arrives_unchanged(message: Message) -> None:
    """Every field keeps its bits and its shape, NaN payloads and -0.0 included."""
    assert all(same(sent, arrived) for sent, arrived in zip(message.sent, message.read(message.raw), strict=True))


@given(messages(), st.data())
def test_a_message_of_another_length_is_refused(message: Message, data: st.DataObject) -> None:
    """The message is cut or extended anywhere, except for optional parts and complete rows."""
    size = data.draw(st.integers(0, len(message.raw) + 50))
    change = size - len(message.raw)
    assume(change and not (message.fits and message.fits(size)))
    raw = message.raw[:size] + b"?" * change
    with pytest.raises(MessageError):
        message.read(raw)


@given(messages(), st.integers(0, 255).filter(lambda version: version != codec.VERSION))
def test_another_version_is_refused(message: Message, version: int) -> None:
    with pytest.raises(MessageError):
        message.read(bytes([version]) + message.raw[1:])


@given(messages(), st.integers(0, 255))
def test_another_kind_is_refused(message: Message, kind: int) -> None:
    if kind == message.raw[1]:
        message.read(message.raw)
        return
    with pytest.raises(MessageError):
        message.read(message.raw[:1] + bytes([kind]) + message.raw[2:])


@given(messages(), st.integers(1, 2**32 - 1))
def test_another_number_of_nodes_is_refused(message: Message, more: int) -> None:
    """This holds even if the length would fit."""
    nodes = (int.from_bytes(message.raw[4:8], "little") + more) % 2**32
    with pytest.raises(MessageError):
        message.read(message.raw[:4] + nodes.to_bytes(4, "little") + message.raw[8:])


@given(messages(), st.integers(-(2**63), -1))
def test_a_step_before_the_first_is_refused(message: Message, t: int) -> None:
    with pytest.raises(MessageError):
        message.read(message.raw[:8] + t.to_bytes(8, "little", signed=True) + message.raw[16:])


@given(st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_a_span_of_no_incidence_is_refused(m: int, incidence: int) -> None:
    raw = codec.encode_state(3, np.zeros(1), bytes(m), [Span(incidence, 0, 1, 0, 0)])
    if incidence < m:
        assert codec.decode_state(raw, 1, m).spans == [(incidence, 0, 1, 0, 0)]
        return
    with pytest.raises(MessageError):
        codec.decode_state(raw, 1, m)


@given(st.lists(messages(), min_size=1, max_size=4), STEPS)
def test_the_messages_of_a_batch_are_as_they_were(sent: list[Message], number: int) -> None:
    whole = codec.encode_batch(number, [(message.raw[:5], message.raw[5:]) for message in sent])
    assert codec.decode_batch(whole) == (number, [message.raw for message in sent])


@given(st.lists(messages(), min_size=1, max_size=3), st.data())
def test_a_batch_of_another_length_is_refused(sent: list[Message], data: st.DataObject) -> None:
    """A batch that ends with one of its messages is the exception: it is a batch too."""
    whole = codec.encode_batch(7, [(message.raw,) for message in sent])
    size = data.draw(st.integers(0, len(whole) + 20).filter(lambda size: size != len(whole)))
    raw = whole[:size] + b"?" * (size - len(whole))
    ends = itertools.accumulate((8 + len(message.raw) for message in sent), initial=8)
    if size in list(ends)[1:]:
        assert len(codec.decode_batch(raw)[1]) < len(sent)
        return
    with pytest.raises(MessageError):
        codec.decode_batch(raw)


@given(messages(), st.integers(-(2**63), 15))
def test_a_message_of_a_batch_is_a_header_long_at_least(message: Message, length: int) -> None:
    whole = codec.encode_batch(7, [(message.raw,)])
    with pytest.raises(MessageError):
        codec.decode_batch(whole[:8] + length.to_bytes(8, "little", signed=True) + whole[16:])


FINITE = st.floats(allow_nan=False, allow_infinity=False)
JSON = st.dictionaries(st.text(), st.integers() | st.text() | st.booleans() | st.lists(FINITE))


@given(STEPS, st.text(), JSON)
def test_an_event_arrives_with_its_step(t: int, name: str, details: dict[str, Any]) -> None:
    raw = codec.encode_event(t, {**details, "event": name})
    assert codec.kind_of(raw) == Kind.EVENT
    assert codec.decode_event(raw) == {**details, "event": name, "step": t}
    with pytest.raises(MessageError):
        codec.decode_event(codec.encode_seen(t))


def header(kind: int, n: int) -> bytes:
    """The start of a message that could be right."""
    return bytes([codec.VERSION, kind, 0, 0]) + n.to_bytes(4, "little")


@given(
    st.one_of(
        st.binary(max_size=200),
        st.builds(
            lambda kind, n, rest: header(kind, n) + rest,
            st.integers(0, 7),
            st.integers(0, 3),
            st.binary(max_size=150),
        ),
    ),
    st.integers(0, 3),
    st.integers(0, 3),
)
@settings(max_examples=examples(300))
def test_no_bytes_do_more_than_be_refused(raw: bytes, n: int, e: int) -> None:
    """Random bytes are the message that was expected, to its last byte, or a MessageError."""
    k = max(1, n)
    readers: dict[Kind, tuple[Callable[[], tuple[Any, ...]], Callable[[int], bool]]] = {
        Kind.STATE: (lambda: codec.decode_state(raw, n, e), lambda size: state_fits(size, n, e)),
        Kind.RECORD: (lambda: codec.decode_record(raw, [e] * n), rows(24 + n, 1)),
        Kind.INPUT: (lambda: codec.decode_input(raw, n, e), either(16 + 24 * n, e)),
        Kind.LINK: (lambda: codec.decode_link(raw, k), rows(24, 16 * k, least=1)),
        Kind.TELEMETRY: (lambda: codec.decode_telemetry(raw, n, e), either(16 + 40 * n, 5 * e)),
        Kind.ROUND_TRIPS: (lambda: codec.decode_round_trips(raw, k), rows(16, 8 * k, least=1)),
        Kind.END: (lambda: codec.decode_end(raw, n), either(32 + 8 * n, 0)),
    }
    for kind, (decode, fits) in readers.items():
        try:
            message = decode()
        except MessageError:
            continue
        assert (raw[0], raw[1]) == (codec.VERSION, kind)
        assert fits(len(raw))
        assert message[0] >= 0
        assert codec.kind_of(raw) == kind


@pytest.mark.parametrize(("t", "first"), [(2, -1), (2, 2), (2, 5), (0, 0), (2**62, -(2**63))])
def test_rows_are_of_steps_that_were(t: int, first: int) -> None:
    """Two rows of a link message end with its step at the latest, and two of a record with the step before it."""
    two = np.zeros((2, 1))
    with pytest.raises(MessageError):
        codec.decode_link(codec.encode_link(Link(t, first, two.tobytes(), two.tobytes()), 1), 1)
    record = Record(t, np.ones(1, np.bool_), first, two, two, np.zeros((2, 3), np.uint8))
    with pytest.raises(MessageError):
        codec.decode_record(codec.encode_record(record), [3])


def test_the_layout_of_a_message_is_the_documented_one() -> None:
    """Other implementations depend on these exact bytes: little-endian, header first."""
    one, two = (np.array([value]).tobytes() for value in (1.0, -2.0))
    raw = codec.encode_link(Link(258, 257, one, two), 1)
    assert raw.hex(" ", 4) == (
        "04020000 01000000 02010000 00000000 01010000 00000000 00000000 0000f03f 00000000 000000c0"
    )
    raw = codec.encode_state(1, np.array([0.5]), np.array([7, 3], np.uint8), [Span(1, 2, 3, 4, 5)])
    assert raw.hex(" ", 2) == (
        "0400 0000 0100 0000 0100 0000 0000 0000 0000 0000 0000 e03f 0703"
        " 0100 0000 0200 0000 0300 0000 0400 0000 0500 0000"
    )
