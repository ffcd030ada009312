"""A run is valid if its telemetry arrives twice: a copy of a message is no message of an intruder."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import zenoh

from hedgerow.wire import keys
from hedgerow.wire.session import close, open_client, subscriber
from tests.tools.processes import Orchestrator, orchestrator
from tests.tools.verdicts import verdict_of


def test_telemetry_that_arrives_twice_leaves_a_run_valid(here: Path) -> None:
    copied = set[bytes]()
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(
            Orchestrator("up", "paper7", "--steps", "300", "--rate", "200", "--viewer", "none", "--no-record")
        )
        network.wait_for("running")
        entry = json.loads(orchestrator("ps", "--json").stdout)[0]
        session = open_client(entry["endpoint"], entry["namespace"])
        stack.callback(close, session)

        def copy(whole: bytes) -> None:
            if whole not in copied:  # it receives its own copies too
                copied.add(whole)
                session.put(keys.TELEMETRY, whole, congestion_control=zenoh.CongestionControl.BLOCK)

        echo = subscriber(session, keys.TELEMETRY, copy)
        assert network.wait() == 0, network.output
        del echo
    verdict = verdict_of(here / "runs/latest")
    assert verdict["verdict"] == "valid"
    assert verdict["checks"]["information"]["ok"]
    telemetry, _ = verdict["information"]["observer"]
    assert telemetry["key"] == keys.TELEMETRY
    assert len(copied) > 2
    assert telemetry["received"] == telemetry["sent"]
