"""The stream from plant to observer over a network with arbitrary losses."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hedgerow.wire.codec import encode_batch
from hedgerow.wire.stream import AHEAD_ROWS, TOGETHER_S, Inbox, Outbox

ACTIONS = ["send", "lossy send", "soon", "lossy soon", "wait", "tend", "lossy repeat", "repeat", "seen", "garbage"]


class Clock:
    """A clock that the test advances."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr("hedgerow.wire.stream.time", SimpleNamespace(monotonic=lambda: self.now_s))


def numbered(number: int) -> bytes:
    return b"%16d" % number + b"." * (number % 3)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(actions=st.lists(st.sampled_from(ACTIONS), max_size=60))
def test_every_message_arrives_once_and_in_order(clock: Clock, actions: list[str]) -> None:
    losing = False
    inbox = Inbox()

    def put(whole: bytes) -> None:
        nonlocal losing
        if not losing:
            inbox.put(whole)
        losing = losing and len(whole) % 2 == 0

    outbox, sent, got = Outbox(put), 0, []
    for action in actions:
        losing = action.startswith("lossy")
        match action.split()[-1]:
            case "send":
                outbox.send(numbered(sent))
                sent += 1
            case "soon":
                outbox.send_soon(numbered(sent))
                sent += 1
            case "wait":
                clock.now_s += TOGETHER_S / 2
            case "tend":
                outbox.tend()
            case "repeat":
                outbox.repeat()
            case "garbage":
                inbox.put(b"?")
            case _:
                outbox.seen(inbox.last)
        got += inbox.drain()
        assert len(outbox) <= sent
    losing = False
    clock.now_s += 2 * TOGETHER_S
    outbox.tend()
    outbox.repeat()
    got += inbox.drain()
    assert [int(message.rstrip(b".")) for message in got] == list(range(sent))
    outbox.seen(inbox.last)
    assert len(outbox) == 0


def test_messages_sent_soon_share_a_batch(clock: Clock) -> None:
    """The first leaves at once; then those of TOGETHER_S, with the last of them or by `tend`; and all of them before an
    urgent one.
    """
    inbox, batches = Inbox(), list[int]()
    outbox = Outbox(lambda whole: batches.append(len(inbox.put(whole))))
    for number in range(7):
        outbox.send_soon(numbered(number))
        clock.now_s += 0.3 * TOGETHER_S
    assert batches == [1, 4]
    outbox.tend()
    assert batches == [1, 4]
    clock.now_s += TOGETHER_S
    outbox.tend()
    assert batches == [1, 4, 2]
    outbox.send_soon(numbered(7))
    outbox.send(numbered(8))
    assert batches == [1, 4, 2, 2]
    assert [int(message.rstrip(b".")) for message in inbox.drain()] == list(range(9))
    assert len(outbox) == 9
    outbox.seen(1)
    assert len(outbox) == 4


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), number=st.integers(1, 12))
def test_batches_that_arrive_several_times_count_once(clock: Clock, data: st.DataObject, number: int) -> None:
    """Zenoh may deliver each batch twice, and the plant repeats batches; both in any order with others."""
    sent: list[bytes] = []
    outbox = Outbox(sent.append)
    for k in range(number):
        outbox.send(numbered(k))
    outbox.repeat()
    assert (outbox.sent, len(sent)) == (number, 2 * number)
    inbox = Inbox()
    for whole in data.draw(st.permutations([*sent, *sent])):
        inbox.put(bytes(bytearray(whole)))
    for whole in sent:
        inbox.put(whole)
    assert inbox.arrived == outbox.sent
    assert [int(message.rstrip(b".")) for message in inbox.drain()] == list(range(number))


@pytest.mark.parametrize("forged", [0, 2, 3, 1000])
def test_a_batch_that_differs_from_that_of_its_number_counts(clock: Clock, forged: int) -> None:
    sent: list[bytes] = []
    outbox, inbox = Outbox(sent.append), Inbox()
    for k in range(3):
        outbox.send(numbered(k))
    for whole in sent:
        inbox.put(whole)
        inbox.put(whole)
    inbox.put(encode_batch(forged, [(numbered(99),)]))
    assert inbox.arrived == outbox.sent + 1


def test_an_inbox_remembers_more_batches_than_a_plant_may_send_again(clock: Clock) -> None:
    sent: list[bytes] = []
    outbox, inbox = Outbox(sent.append), Inbox()
    for k in range(3 * AHEAD_ROWS):
        outbox.send(numbered(k))
        outbox.seen(k - AHEAD_ROWS - 1)
    for whole in sent:
        inbox.put(whole)
    outbox.repeat()
    for whole in sent[3 * AHEAD_ROWS :]:
        inbox.put(whole)
    assert inbox.arrived == outbox.sent == 3 * AHEAD_ROWS
