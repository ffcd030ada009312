"""Messages: what is sent is what arrives, bit for bit; anything else is refused in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wire import codec
from wire.codec import End, Kind, MessageError, Telemetry

BITS = st.integers(0, 2**64 - 1)
"""Any eight bytes are a float: NaNs with payloads, -0.0, infinities and subnormals among them."""
STEPS = st.integers(0, 2**63 - 1)


class Message(NamedTuple):
    """A message, its sender's fields, and how its receiver reads it."""

    raw: bytes
    sent: tuple[Any, ...]
    read: Callable[[bytes], tuple[Any, ...]]


def seen(raw: bytes) -> tuple[int]:
    return (codec.decode_seen(raw),)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Any message between processes that share n nodes and e edges (or incidences)."""
    n, e, t = draw(st.integers(0, 5)), draw(st.integers(0, 6)), draw(STEPS)

    def array(count: int, width: int = 0) -> codec.Array:
        size = count * (width or 1)
        values = np.array(draw(st.lists(BITS, min_size=size, max_size=size)), np.uint64).view("<f8")
        return values.reshape(count, width) if width else values

    def flags(count: int) -> codec.Flags:
        return np.frombuffer(draw(st.binary(min_size=count, max_size=count)), np.uint8)

    x, u, w, report = array(n), array(n), array(n), array(n, codec.REPORT_WIDTH)
    row = Telemetry(t, x, u, w, report, flags(e), flags(2 * e))
    elapsed_s = draw(st.floats(0, 1e9))
    up = flags(e)
    kinds: list[Message] = [
        Message(codec.encode_state(t, x, up), (t, x, up), lambda m: codec.decode_state(m, n, e)),
        Message(codec.encode_input(t, u, report), (t, u, report), lambda m: codec.decode_input(m, n)),
        Message(codec.encode_link(t, x, u), (t, x, u), lambda m: codec.decode_link(m, n)),
        Message(codec.encode_telemetry(row), row, lambda m: codec.decode_telemetry(m, n, e)),
        Message(
            codec.encode_end(End(t, x, elapsed_s)),
            (t, x, elapsed_s),
            lambda m: codec.decode_end(m, n),
        ),
        Message(codec.encode_seen(t), (t,), seen),
    ]
    message: Message = draw(st.sampled_from(kinds))
    return message


@given(messages())
def test_what_is_sent_is_what_arrives(message: Message) -> None:
    """Every field has the bits and the shape that it had, NaN payloads and -0.0 included."""
    for sent, arrived in zip(message.sent, message.read(message.raw), strict=True):
        if isinstance(arrived, bytes):
            assert np.asarray(sent).tobytes() == arrived
        else:
            assert np.shape(sent) == np.shape(arrived)
            assert np.asarray(sent).tobytes() == np.asarray(arrived).tobytes()


@given(messages(), st.data())
def test_a_message_of_another_length_is_refused(message: Message, data: st.DataObject) -> None:
    """Cut short anywhere, or with bytes behind it."""
    cut = message.raw[: data.draw(st.integers(0, len(message.raw) - 1))]
    longer = message.raw + data.draw(st.binary(min_size=1, max_size=9))
    for raw in (cut, longer):
        with pytest.raises(MessageError, match=r"bytes are too short|expected [A-Z]+ \(\d\) with"):
            message.read(raw)


@given(messages(), st.integers(0, 255).filter(lambda version: version != codec.VERSION))
def test_another_version_is_refused(message: Message, version: int) -> None:
    with pytest.raises(MessageError, match=f"version {version}, and this process speaks 1"):
        message.read(bytes([version]) + message.raw[1:])


@given(messages(), st.integers(0, 255))
def test_another_kind_is_refused(message: Message, kind: int) -> None:
    if kind == message.raw[1]:
        message.read(message.raw)
        return
    with pytest.raises(MessageError, match=f"kind {kind} with .*, expected "):
        message.read(message.raw[:1] + bytes([kind]) + message.raw[2:])


@given(messages(), st.integers(1, 2**32 - 1))
def test_another_number_of_nodes_is_refused(message: Message, more: int) -> None:
    """Even where the length would fit."""
    nodes = (int.from_bytes(message.raw[4:8], "little") + more) % 2**32
    with pytest.raises(MessageError, match=f"with {nodes} nodes in"):
        message.read(message.raw[:4] + nodes.to_bytes(4, "little") + message.raw[8:])


@given(messages(), st.integers(-(2**63), -1))
def test_a_step_before_the_first_is_refused(message: Message, t: int) -> None:
    with pytest.raises(MessageError, match=f"step {t} is before the first"):
        message.read(message.raw[:8] + t.to_bytes(8, "little", signed=True) + message.raw[16:])


def header(kind: int, n: int) -> bytes:
    """The start of a message that could be right."""
    return bytes([codec.VERSION, kind, 0, 0]) + n.to_bytes(4, "little")


@given(
    st.one_of(
        st.binary(max_size=200),
        st.builds(
            lambda kind, n, rest: header(kind, n) + rest,
            st.integers(0, 5),
            st.integers(0, 3),
            st.binary(max_size=150),
        ),
    ),
    st.integers(0, 3),
    st.integers(0, 3),
)
@settings(max_examples=300)
def test_no_bytes_do_more_than_be_refused(raw: bytes, n: int, e: int) -> None:
    """Random bytes are the message that was expected, to its last byte, or a MessageError."""
    sizes: dict[Kind, tuple[Callable[[], tuple[Any, ...]], int]] = {
        Kind.STATE: (lambda: codec.decode_state(raw, n, e), 8 * n + e),
        Kind.INPUT: (lambda: codec.decode_input(raw, n), 40 * n),
        Kind.LINK: (lambda: codec.decode_link(raw, n), 16 * n),
        Kind.TELEMETRY: (lambda: codec.decode_telemetry(raw, n, e), 56 * n + 3 * e),
        Kind.END: (lambda: codec.decode_end(raw, n), 8 * n + 8),
    }
    for kind, (decode, size) in sizes.items():
        try:
            message = decode()
        except MessageError:
            continue
        assert (raw[0], raw[1], len(raw)) == (codec.VERSION, kind, 16 + size)
        assert message[0] >= 0
        assert codec.kind_of(raw) == kind


def test_the_layout_of_a_message_is_the_documented_one() -> None:
    """Other implementations rely on these very bytes: little-endian, header first."""
    raw = codec.encode_link(258, np.array([1.0]), np.array([-2.0]))
    assert raw.hex(" ", 4) == "01020000 01000000 02010000 00000000 00000000 0000f03f 00000000 000000c0"
    raw = codec.encode_state(1, np.array([0.5]), np.array([7, 3], np.uint8))
    assert raw.hex(" ", 4) == "0100 00000100 00000100 00000000 00000000 00000000 e03f0703"
