"""The stream from plant to observer over a wire that loses what it likes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from wire.stream import Inbox, Outbox


@given(st.lists(st.sampled_from(["send", "lossy send", "seen", "lossy repeat", "repeat", "garbage"]), max_size=60))
def test_every_message_arrives_once_and_in_order(actions: list[str]) -> None:
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
                outbox.send(b"%16d" % sent + b"." * (sent % 3))
                sent += 1
            case "repeat":
                outbox.repeat()
            case "garbage":
                inbox.put(b"?")
            case _:
                outbox.seen(inbox.last)
        got += inbox.drain()
    losing = False
    outbox.repeat()
    got += inbox.drain()
    assert [int(message.rstrip(b".")) for message in got] == list(range(sent))
    outbox.seen(inbox.last)
    assert len(outbox) == 0
