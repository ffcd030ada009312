"""JSON from the network: values that are too deep, too large or not text are refused; others can be forwarded."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.plant import request
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.graph import Graph
from hedgerow.wire import bounded_json, codec
from hedgerow.wire.message import MessageError

GRAPH = Graph(2, np.array([[0, 1]]))
HEADER = codec.encode_event(3, {})[:-2]


def nested(depth: int) -> str:
    """Return a value of that many objects, one in another."""
    return '{"a":' * depth + "1" + "}" * depth


REFUSED = [
    *(nested(depth) for depth in (9, 100, *range(975, 1000), 100_000)),
    '{"a":' + "[" * 985 + "]" * 985 + "}",
    '{"who": "\\ud800"}',
    '{"\\udfff": 1}',
    '{"rate": NaN}',
    '{"rate": -Infinity}',
    '{"rate": 1e999}',
    '{"number": ' + "9" * 5000 + "}",
    "",
    "{",
    "[1]",
    "null",
]


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_an_event_that_cannot_be_passed_on_is_refused(text: str) -> None:
    with pytest.raises(MessageError) as refused:
        codec.decode_event(HEADER + text.encode())
    assert refused.value.code == Code.MESSAGE


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_a_command_that_cannot_be_passed_on_is_refused(text: str) -> None:
    with pytest.raises(UserError) as refused:
        request.read(text.encode(), GRAPH)
    assert refused.value.code == Code.MESSAGE


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32", "latin-1"])
def test_text_that_is_not_utf_8_is_refused(encoding: str) -> None:
    with pytest.raises(MessageError):
        codec.decode_event(HEADER + '{"who": "é"}'.encode(encoding))


def test_bytes_and_values_are_bounded_before_the_text_is_parsed() -> None:
    assert bounded_json.decode(b"[1, 2]", most_bytes=6) == [1, 2]
    with pytest.raises(ValueError):
        bounded_json.decode(b"[1, 2]", most_bytes=5)
    assert len(bounded_json.decode(b"[" + b"1," * (bounded_json.MOST_VALUES - 2) + b"1]")) < bounded_json.MOST_VALUES
    with pytest.raises(ValueError):
        bounded_json.decode(b"[" + b"1," * bounded_json.MOST_VALUES + b"1]")
    with pytest.raises(MessageError):
        codec.decode_event(HEADER + b'{"event": "counted"}', most_bytes=8)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(), inside, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), JSON, max_size=3))
def test_a_decoded_message_encodes_to_the_same_bytes(event: dict[str, Any]) -> None:
    try:
        decoded = codec.decode_event(codec.encode_event(3, event))
    except MessageError:
        with pytest.raises(ValueError):
            bounded_json.decode(json.dumps(event).encode())
        return
    assert decoded == {**event, "step": 3}
    assert codec.decode_event(codec.encode_event(3, decoded)) == decoded
    json.dumps(decoded, ensure_ascii=False).encode()


def test_an_event_that_json_cannot_hold_is_refused_by_its_sender() -> None:
    deep: list[Any] = []
    for _ in range(5000):
        deep = [deep]
    for event in ({"entry": deep}, {"entry": {1, 2}}):
        with pytest.raises(MessageError):
            codec.encode_event(0, event)
