"""The commands that a running plant answers: report its status, pause and resume, start and end faults.

Every command is a query on `control/NAME` with JSON in it and JSON in the reply; `error` in the reply names the
problem. Any process may send a request; a malformed one is refused with a message (plant.request).
"""

from __future__ import annotations

import contextlib
import json
import logging
import re
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import zenoh

from hedgerow.plant import request as requests
from hedgerow.plant.allowance import (
    BYTES_PER_COMMAND,
    COMMANDS_AT_ONCE,
    COMMANDS_PER_S,
    JOINS_AT_ONCE,
    JOINS_PER_S,
    Allowance,
)
from hedgerow.plant.fault_entry import FaultEntries
from hedgerow.plant.request import Request
from hedgerow.topologies.effects import FOREVER
from hedgerow.topologies.errors import Code, UserError
from hedgerow.wire import keys
from hedgerow.wire.handshake import introduction, mismatch
from hedgerow.wire.message import MessageError
from hedgerow.wire.session import direct

if TYPE_CHECKING:
    from hedgerow.plant.process import Plant

LOG = logging.getLogger("plant")
Reply = dict[str, Any]
FASTEST = 1e9
"""steps per second"""
CLAIM_S = 10.0
"""The time for which a place is reserved for the process that asked; the process asks again before it takes the
place.
"""
OBSERVER = "observer"
"""the key on which the observer asks to join"""
MOST_CAUSES = 4
"""The maximum number of refusal causes per place that the observer receives, each once.

The refused process chooses the versions in them.
"""
_VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z.+!_-]{0,63}|")
"""a release, or a fingerprint of a network; no other text of a refused process reaches the screen"""


class Control:
    """The commands of one plant."""

    def __init__(self, plant: Plant, session: zenoh.Session) -> None:
        self._plant = plant
        self._allowances: dict[str, Allowance] = {}
        """the allowances by key"""
        truth = plant.truth
        self._entries = FaultEntries(plant.world.graph, truth.ids, truth.shards, truth.candidates)
        self._refused: dict[str, set[str]] = {}
        """the causes that the observer has received, by place"""
        commands: dict[str, Callable[[Request], Reply]] = {
            "status": self._status,
            "stop": self._stop,
            "pause": self._pause,
            "resume": self._resume,
            "step": self._step,
            "rate": self._rate,
            "fault": self._fault,
            "heal": self._heal,
            "died": self._died,
            "join": self._join,
        }
        self._declared = [self._declare(session, name, command) for name, command in commands.items()]

    def _declare(self, session: zenoh.Session, name: str, command: Callable[[Request], Reply]) -> object:
        # Each process asks to join on its own key. So the router of a secure run can refuse a process that asks for
        # another's place.
        key = keys.join("*") if name == "join" else keys.control(name)

        def answer(query: zenoh.Query) -> None:
            asked = str(query.key_expr)
            if "*" in asked:  # a wildcard query such as `**` only looks around and changes nothing
                with contextlib.suppress(zenoh.ZError):
                    query.reply_err(f"{name}: asked by {requests.shortened(asked)}; a command is asked by its own key")
                return
            try:
                payload = query.payload.to_bytes() if query.payload is not None else b"{}"
                if not self._allowance(name, asked).take(1 + len(payload) // BYTES_PER_COMMAND):
                    raise _TooOftenError
                request = requests.read(payload, self._plant.world.graph)
                with self._plant.changed:
                    reply = command({**request, "who": asked.rpartition("/")[2]} if name == "join" else request)
                    self._plant.changed.notify_all()
            except _TooOftenError:
                reply = {"error": f"{name}: asked too often; ask again a second later", "wait": True}
            except (UserError, MessageError) as error:
                reply = {"error": f"{name}: {error}"}
            with contextlib.suppress(zenoh.ZError):  # the sender or this process is leaving
                query.reply(asked if name == "join" else key, json.dumps(reply))

        return session.declare_queryable(key, direct(answer))

    def _allowance(self, name: str, asked: str) -> Allowance:
        """Return the allowance of a command, or of one place: too many requests for one place delay no other place."""
        if name != "join":
            return self._allowances.setdefault(name, Allowance(COMMANDS_PER_S, COMMANDS_AT_ONCE))
        place = asked.rpartition("/")[2]
        if place != OBSERVER:
            place = str(requests.shard(place, len(self._plant.shards.all)))
        return self._allowances.setdefault(f"join/{place}", Allowance(JOINS_PER_S, JOINS_AT_ONCE))

    @property
    def _next(self) -> int:
        """Return the first step that is not decided yet."""
        return self._plant.world.t + self._plant.running

    @property
    def _held(self) -> int:
        """Return the first step of which no state was sent."""
        return self._plant.world.t + (self._plant.running and not self._plant.clock.held)

    def _status(self, _: Request) -> Reply:
        plant = self._plant
        return {
            "step": plant.world.t,
            "steps": plant.truth.steps,
            "running": plant.running,
            "paused": plant.clock.paused,
            "rate": plant.clock.rate,
            "missing": plant.missing,
            "lost": [shard.name for shard in plant.shards.all if shard.fault is not None],
            "absent": {str(p): shard.name for p, shard in enumerate(plant.shards.all) if not shard.alive},
        }

    def _stop(self, _: Request) -> Reply:
        self._plant.stop()
        return {"step": self._plant.world.t}

    def _pause(self, _: Request) -> Reply:
        self._plant.clock.pause()
        self._plant.report_event("pause", at=self._held)
        return {"step": self._held}

    def _resume(self, _: Request) -> Reply:
        self._plant.clock.resume(self._plant.world.t)
        self._plant.report_event("resume", at=self._plant.world.t)
        return {"step": self._plant.world.t}

    def _step(self, request: Request) -> Reply:
        self._plant.clock.allow(requests.integer(request, "steps", 1, FOREVER))
        return {"step": self._held}

    def _rate(self, request: Request) -> Reply:
        rate = requests.number(request, "rate", 0, FASTEST)
        self._plant.clock.set_rate(rate, self._plant.world.t)
        self._plant.report_event("rate", at=self._plant.world.t, rate=rate)
        return {"step": self._plant.world.t}

    def _fault(self, request: Request) -> Reply:
        """Add a fault, which the request gives as a file entry with steps relative to the first possible step."""
        plant, start = self._plant, self._next
        if plant.over:
            return {"error": "the run is over"}
        number = plant.world.fault_count
        entry = shift_entry(requests.entry(request), start)
        added = self._entries.effects(entry, number)
        plant.world.faults.add(added)
        plant.world.fault_count += 1
        start = min((one.start for one in added), default=start)
        plant.report_event("fault", fault=number, entry=entry, at=start)
        return {"fault": number + 1, "step": start, "entry": entry}

    def _heal(self, request: Request) -> Reply:
        """End a fault, by its number from 1, or all active faults. A crashed agent returns one step later."""
        plant, at = self._plant, self._next
        wanted = None if request.get("fault") is None else requests.integer(request, "fault", 1, FOREVER)
        if wanted is not None and wanted > plant.world.fault_count:
            raise UserError(f"there is no fault {wanted}; there are {plant.world.fault_count}", code=Code.FAULT)
        lost = {shard.fault for shard in plant.shards.all}
        ended = {}
        for one in plant.world.faults.effects:
            stop = at + one.removes_agents
            asked = wanted is None or one.fault == wanted - 1
            if asked and one.lossy and one.fault not in lost and one.start < stop < one.stop:
                ended[one.fault] = stop
        if wanted is not None and not ended:
            return {"error": f"fault {wanted} has not begun, is over, or is a jump: there is nothing to heal"}
        for number, stop in ended.items():
            plant.world.faults.end(number, stop)
            plant.report_event("heal", fault=number, at=stop)
        return {"faults": [number + 1 for number in sorted(ended)], "step": at}

    def _died(self, request: Request) -> Reply:
        plant = self._plant
        p = requests.integer(request, "shard", 0, len(plant.shards.all) - 1)
        shard = plant.shards.all[p]
        # A restarted process may end before its token was seen, but then no later one can exist yet.
        life = requests.integer(request, "life", 0, max(shard.life, shard.died) + 1)
        plant.died(p, life)
        return {} if shard.seen >= life else {"unreached": True}

    def _join(self, request: Request) -> Reply:
        """Give a separate process its place: return the number of its life, or the reason for a refusal.

        The key of the query names the process: a secure router lets no other process ask on that key.
        """
        plant, place = self._plant, request["who"]
        p = None if place == OBSERVER else requests.shard(place, len(plant.shards.all))
        requests.text(request, "process")  # it must be a name, but the plant trusts only the key
        theirs = {key: _version(request, key) for key in ("hedgerow", "network")}
        why = mismatch(plant.network, {**theirs, "codec": requests.integer(request, "codec", 0, FOREVER)})
        if why is not None:
            self._report_refused("the observer" if p is None else plant.shards.all[p].name, why)
            return {"error": why, **introduction(plant.network)}
        if p is None:
            return introduction(plant.network)
        if plant.over:
            return {"error": "the run is over", "wait": True}
        shard = plant.shards.all[p]
        number, now = requests.integer(request, "number", 0, FOREVER), time.monotonic()
        if shard.alive or (shard.claim not in (-1, number) and now < shard.claimed_until):
            return {"error": f"{shard.name} is there already", "wait": True}
        shard.external, shard.claim, shard.claimed_until = True, number, now + CLAIM_S
        return {"life": shard.life + 1, "plant": plant.number}

    def _report_refused(self, who: str, cause: str) -> None:
        """Log a refusal and report it to the observer, once per cause: a refused process asks again and again."""
        reported = self._refused.setdefault(who, set())
        if cause not in reported and len(reported) < MOST_CAUSES:
            reported.add(cause)
            LOG.warning("%s is refused: %s", who, cause)
            self._plant.report_event("refused", who=who, cause=cause)


class _TooOftenError(Exception):
    """A query above the rate of plant.allowance."""


def _version(request: Request, key: str) -> str | None:
    """Return the release or the fingerprint in a request; raise UserError if it cannot be one."""
    value = requests.text(request, key)
    if value is not None and not _VERSION.fullmatch(value):
        raise UserError(f"{key}: {requests.shortened(value)} is no version", code=Code.MESSAGE)
    return value


def shift_entry(entry: Mapping[str, Any], by: int) -> dict[str, Any]:
    """Return a fault entry with its steps moved by `by`; one without `steps` starts there and never ends."""
    moved = dict(entry)
    if "steps" in entry:
        moved["steps"] = [min(step + by, FOREVER) for step in entry["steps"]]
    elif "at" not in entry:
        moved["steps"] = [by, FOREVER]
    if isinstance(at := entry.get("at"), int):
        moved["at"] = min(at + by, FOREVER)
    elif isinstance(at, Mapping):
        moved["at"] = {str(int(step) + by): pairs for step, pairs in at.items()}
    return moved
