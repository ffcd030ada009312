"""What a running plant can be asked: where it is, to pause and go on, and to let faults come and go.

Every command is a query on `control/NAME` with JSON in it and JSON in the reply; `error` there says what is wrong.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import zenoh

from topologies.effects import FOREVER, Effect
from wire import keys
from wire.handshake import introduction, mismatch

if TYPE_CHECKING:
    from plant.process import Plant

LOG = logging.getLogger("plant")
Request = Mapping[str, Any]
Reply = dict[str, Any]


class Control:
    """The commands of one plant."""

    def __init__(self, plant: Plant, session: zenoh.Session) -> None:
        self._plant = plant
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
        def answer(query: zenoh.Query) -> None:
            try:
                request = json.loads(query.payload.to_bytes()) if query.payload is not None else {}
                with self._plant.changed:
                    reply = command(request)
                    self._plant.changed.notify_all()
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                reply = {"error": f"no such request: {type(error).__name__}: {error}"}
            query.reply(keys.control(name), json.dumps(reply))

        return session.declare_queryable(keys.control(name), zenoh.handlers.Callback(answer, indirect=False))

    @property
    def _next(self) -> int:
        """The first step that is not yet decided."""
        return self._plant.world.t + self._plant.running

    @property
    def _held(self) -> int:
        """The first step whose states have not been sent."""
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
            "lost": [plant.name(p) for p, shard in enumerate(plant.shards) if shard.fault is not None],
            "absent": [plant.name(p) for p, shard in enumerate(plant.shards) if not shard.alive],
        }

    def _stop(self, _: Request) -> Reply:
        self._plant.stopping = True
        return {"step": self._plant.world.t}

    def _pause(self, _: Request) -> Reply:
        self._plant.clock.pause()
        self._plant.tell("pause", at=self._held)
        return {"step": self._held}

    def _resume(self, _: Request) -> Reply:
        self._plant.clock.resume(self._plant.world.t)
        self._plant.tell("resume", at=self._plant.world.t)
        return {"step": self._plant.world.t}

    def _step(self, request: Request) -> Reply:
        if (steps := int(request["steps"])) < 1:
            return {"error": f"{steps} steps cannot be made; give 1 or more"}
        self._plant.clock.allow(steps)
        return {"step": self._held}

    def _rate(self, request: Request) -> Reply:
        if not 0 <= float(request["rate"]) < float("inf"):
            return {"error": f"{request['rate']} is no rate; give steps per second, 0 for as fast as possible"}
        self._plant.clock.set_rate(float(request["rate"]), self._plant.world.t)
        self._plant.tell("rate", at=self._plant.world.t, rate=request["rate"])
        return {"step": self._plant.world.t}

    def _fault(self, request: Request) -> Reply:
        """A fault as a file spells it and what it means, both with steps counted from the first that can be had."""
        plant, start = self._plant, self._next
        if plant.over:
            return {"error": "the run is over"}
        number = plant.fault_count
        effects = [Effect.from_dict({**one, "fault": number}) for one in request["effects"]]
        entry = shift_entry(request["entry"], start)
        shifted = [_shifted(one, start) for one in effects]
        plant.world.faults.add(shifted)
        plant.fault_count += 1
        start = min((one.start for one in shifted), default=start)
        plant.tell("fault", fault=number, entry=entry, at=start)
        return {"fault": number + 1, "step": start, "entry": entry}

    def _heal(self, request: Request) -> Reply:
        """End a fault, by its number from 1, or all that are at work; a crashed agent needs one step to be told."""
        plant, at = self._plant, self._next
        wanted = request.get("fault")
        if wanted is not None and not 1 <= wanted <= plant.fault_count:
            return {"error": f"there is no fault {wanted}; there are {plant.fault_count}"}
        lost = {shard.fault for shard in plant.shards}
        ended = {}
        for one in plant.world.faults.effects:
            stop = at + (one.kind == "crash")
            asked = wanted is None or one.fault == wanted - 1
            if asked and one.kind != "jump" and one.fault not in lost and one.start < stop < one.stop:
                ended[one.fault] = stop
        if wanted is not None and not ended:
            return {"error": f"fault {wanted} has not begun, is over, or is a jump: there is nothing to heal"}
        for number, stop in ended.items():
            plant.world.faults.end(number, stop)
            plant.tell("heal", fault=number, at=stop)
        return {"faults": [number + 1 for number in sorted(ended)], "step": at}

    def _died(self, request: Request) -> Reply:
        self._plant.died(int(request["shard"]), int(request["life"]))
        return {}

    def _join(self, request: Request) -> Reply:
        """A process that nobody here started wants its place: the number of its life, or why it cannot have one."""
        plant = self._plant
        why = mismatch(plant.network, request)
        if why is not None:
            LOG.warning("%s is refused: %s", request.get("process"), why)
            plant.tell("refused", who=request.get("process"), cause=why)
            return {"error": why, **introduction(plant.network)}
        if request.get("shard") is None:
            return introduction(plant.network)
        shard = plant.shards[int(request["shard"])]
        if shard.alive:
            return {"error": f"{plant.name(int(request['shard']))} is there already", "wait": True}
        shard.external = True
        return {"life": shard.life + 1}


def _shifted(effect: Effect, by: int) -> Effect:
    table = None if effect.table is None else {step + by: targets for step, targets in effect.table.items()}
    return replace(effect, start=effect.start + by, stop=min(effect.stop + by, FOREVER), table=table)


def shift_entry(entry: Mapping[str, Any], by: int) -> dict[str, Any]:
    """A fault as a file spells it, so many steps later; one without `steps` begins there and never ends."""
    moved = dict(entry)
    if "steps" in entry:
        moved["steps"] = [min(step + by, FOREVER) for step in entry["steps"]]
    elif "at" not in entry:
        moved["steps"] = [by, FOREVER]
    if isinstance(at := entry.get("at"), int):
        moved["at"] = at + by
    elif isinstance(at, Mapping):
        moved["at"] = {str(int(step) + by): pairs for step, pairs in at.items()}
    return moved
