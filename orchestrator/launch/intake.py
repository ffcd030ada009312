"""The intake of telemetry: batches on the network thread, rows and events on the main thread."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Sequence
from typing import Any

import zenoh

from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import Layout, places
from hedgerow.orchestrator.launch.fault_changes import changes_before, with_end, with_fault, with_loss
from hedgerow.orchestrator.launch.plant_event import checked
from hedgerow.orchestrator.launch.recording import Recording
from hedgerow.orchestrator.launch.supervisor import Processes
from hedgerow.orchestrator.metrics.message_audit import audit, observed
from hedgerow.orchestrator.metrics.verdict import Ending
from hedgerow.orchestrator.runs.folder import RunFolder
from hedgerow.orchestrator.views.event_line import event_line
from hedgerow.orchestrator.views.screen import Screen
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.schema import Topology
from hedgerow.wire import keys
from hedgerow.wire.codec import (
    decode_end,
    decode_event,
    decode_round_trips,
    decode_telemetry,
    encode_seen,
    kind_of,
    telemetry_bytes,
)
from hedgerow.wire.message import Kind, MessageError, Telemetry
from hedgerow.wire.runtime import LONG_BYTES, keep_memory
from hedgerow.wire.session import Receiver, Sender
from hedgerow.wire.shared_rows import SharedRows
from hedgerow.wire.stream import Inbox, rows_ahead

WAKE_ROWS = 512
"""The number of rows per reading, unless half of the rows that the plant waits for is less."""


LOOK_S = 0.1
"""The time between two looks at a viewer that does not answer yet [s]."""


class Intake:
    """The telemetry of one run on its way from the plant into the recording."""

    def __init__(
        self,
        run: Recording,
        folder: RunFolder,
        shards: Layout,
        views: Sequence[View],
        screen: Screen,
        ending: Ending,
        wake: threading.Event,
        shared: SharedRows | None = None,
    ) -> None:
        """Set `wake` whenever a message should not wait for the next tick; `shared` holds the rows of the plant."""
        self._run, self._folder, self._shards, self._views = run, folder, shards, views
        self._screen, self._ending, self._wake = screen, ending, wake
        self._size = len(run.topology.ids), len(run.topology.edges)
        self._inbox = Inbox(None if shared is None else shared.read)
        if telemetry_bytes(*self._size) > LONG_BYTES:
            keep_memory()
        self._wake_rows = min(WAKE_ROWS, rows_ahead(*self._size) // 2)
        self.first_at: float | None = None
        """the arrival of the first step, by time.monotonic()"""
        self._repeated = False
        """True if the plant has sent a batch again that we have"""
        self._announced = True
        """False while the viewer has started, and its link does not answer yet"""
        self._look_at = 0.0
        self._refused = 0
        """messages on `telemetry` that no plant sends"""

    def open(self, session: zenoh.Session) -> Receiver:
        """Subscribe to the telemetry of the plant; close the result to end that."""
        self._receiver, self._seen = Receiver(session, keys.TELEMETRY, self._put), Sender(session, keys.SEEN)
        return self._receiver

    def _put(self, whole: bytes) -> None:
        """Accept a batch on the network thread, and wake up the main thread for anything urgent."""
        messages = self._inbox.put(whole)
        if not messages:  # our acknowledgement was lost
            self._repeated = True
        kinds = set(map(kind_of, messages))
        if Kind.TELEMETRY in kinds and self.first_at is None:
            self.first_at = time.monotonic()
            self._wake.set()
        elif kinds & {Kind.EVENT, Kind.END} or len(self._inbox) >= self._wake_rows:
            self._wake.set()

    def take(self, processes: Processes) -> bool:
        """Observe the received messages in their order and acknowledge them; return False if there were none."""
        self._announce()
        messages = self._inbox.drain()
        run, (n, e) = self._run, self._size
        for kind, some in itertools.groupby(messages, kind_of):
            match kind:
                case Kind.TELEMETRY:
                    self._take_rows([decode_telemetry(message, n, e) for message in some])
                case Kind.EVENT:
                    for message in some:
                        try:
                            event = checked(decode_event(message), len(self._shards), len(run.topology.faults))
                        except MessageError as error:
                            self._refuse(error)
                        else:
                            self._take_event(processes, event)
                case Kind.ROUND_TRIPS:
                    for message in some:
                        run.take_round_trips(decode_round_trips(message, len(self._shards)))
                case Kind.END:
                    run.finish(decode_end(next(some), n))
        if not (messages or self._repeated):
            return False
        self._repeated = False
        self._seen.put(encode_seen(self._inbox.last))
        return True

    def _refuse(self, error: MessageError) -> None:
        """Report the first message on `telemetry` that no plant sends; the run continues without it."""
        if not self._refused:
            self._screen.say(f"{keys.TELEMETRY}: refused: {error}; another process writes there")
            self._folder.event("refused_message", why=str(error))
        self._refused += 1

    def _take_rows(self, rows: Sequence[Telemetry]) -> None:
        run = self._run
        unseen = run.viewer is None
        for some in range(0, len(rows), run.rows_at_once):
            if (batch := run.take(rows[some : some + run.rows_at_once])) is not None:
                self._screen.progress(batch)
        if unseen and run.viewer is not None:
            self._announced = False
        run.warn(self._screen)

    def _announce(self) -> None:
        """Print the link of the viewer once it answers: a browser that asks before shows an error."""
        viewer, now = self._run.viewer, time.monotonic()
        if self._announced or viewer is None or now < self._look_at:
            return
        self._look_at = now + LOOK_S
        if viewer.gone:  # the feeder warns
            self._announced = True
        elif viewer.answers():
            self._announced = True
            ends = "" if viewer.link is None or self._run.page_stays else " until the run ends (--keep leaves it open)"
            self._screen.say(f"watch it at {viewer.link or viewer.url}{ends}")

    def _changed(self, topology: Topology, event: dict[str, Any]) -> Topology | None:
        """Return the topology with the faults after an event; None if they stay.

        Raise HedgerowError for a change that no plant makes: in an open network, any process may write an event.
        """
        changed = self._changed_faults(topology, event)
        # The rows of earlier steps are judged and recorded: no plant changes what happened in them.
        if changed is not None and changes_before(self._run.observer.next_step, topology, changed):
            raise HedgerowError(f"an event {event['event']} that changes a step of the past")
        return changed

    def _changed_faults(self, topology: Topology, event: dict[str, Any]) -> Topology | None:
        match event["event"]:
            case "lost":
                nodes = [topology.ids[k] for k in self._shards[event["shard"]]]
                return with_loss(topology, event["shard"], nodes, event["step"])
            case "back" | "heal":
                return with_end(topology, event["fault"], event["at"])
            case "fault":
                return with_fault(topology, event["entry"])
        return None

    def _take_event(self, processes: Processes, event: dict[str, Any]) -> None:
        """Act on an event of the plant between two steps, record it, and update the resolved file."""
        run, step = self._run, event["step"]
        topology = run.topology
        try:
            changed = self._changed(topology, event)
        except HedgerowError as error:
            self._refuse(MessageError(str(error)))
            return
        recorded = {**event, "fault": event["fault"] + 1} if "fault" in event else event  # users count from 1
        if event["event"] != "counts":  # verdict.json has it
            details = {key: value for key, value in recorded.items() if key != "event"}
            self._folder.event(event["event"], **details)
        match event["event"]:
            case "counts":
                self._ending.audit = audit(
                    places(self._views), event, observed(self._seen, self._receiver, self._inbox)
                )
            case "kill":
                processes.kill(event["shard"], event["life"], event["restart"])
            case "revive":
                processes.revive(event["shard"])
            case "lost":
                self._ending.losses.add(event["fault"])
                if slow := processes.slow_law(step, event["shard"]):
                    recorded = {**recorded, "cause": f"{event['cause']}; {slow}"}
            case "refused":
                self._screen.say(f"{event['who']} is refused: {event['cause']}")
        if changed is not None:
            run.change(changed)
        if (line := event_line(recorded)) is not None:
            self._screen.say(line.text)
            run.note(line.text, line.level, step)
