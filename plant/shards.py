"""Who takes part in a run: which shards are there, which are lost, and how one comes back.

A shard is lost when its process dies or does not answer, and no fault of the file says so. To the world that is a crash
of its nodes, one fault more, which ends once the shard is heard of again. Every method runs with the plant's lock held.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from hedgerow.plant.clock import RESEND_AFTER_S
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.wire import keys
from hedgerow.wire.codec import encode_quiet_states, encode_record, encode_state
from hedgerow.wire.session import Sender


@dataclass
class Shard:
    """One agent process as the plant sees it."""

    name: str
    """what messages call it"""
    nodes: Sequence[int]
    incidences: int
    state: Sender
    messages: list[bytes] = field(default_factory=list)
    """what it is told at this step"""
    life: int = -1
    """how often it was started again; -1 before it was ever seen"""
    alive: bool = False
    """True while its token is present"""
    seen: int = -1
    """the last life whose token came: it had reached the router"""
    died: int = -1
    """the last life that is over"""
    gone: bool = False
    """that life was needed, and the step after its end has not begun"""
    fault: int | None = None
    """since it was lost: the number of the crash which that is, in the list of faults"""
    back: bool = False
    """it was heard of since then"""
    returning: bool = False
    """it was lost, and has not acted since it was taken back"""
    word: dict[str, Any] | None = None
    """its last: what it said and heard, by key"""
    external: bool = False
    """True if another program restarts the process, and not `up`."""
    claim: int = -1
    """the number of the process that asked for this place last, and was given it"""
    claimed_until: float = 0.0
    """how long it is kept for that process, which is not there yet"""

    @property
    def ready(self) -> bool:
        """Return True if a state can be sent to it."""
        return self.alive and self.life > self.died

    @property
    def found(self) -> bool:
        """Whether it was lost, and is there again: an input of who has died since may come late."""
        return self.fault is not None and self.back and self.life > self.died

    def send(self) -> None:
        """Send it what it is told at this step."""
        for message in self.messages:
            self.state.put(message)


class Shards:
    """All shards of a run, and what the step at hand waits for."""

    def __init__(self, truth: Truth, world: World, session: zenoh.Session, tell: Callable[..., None]) -> None:
        """`tell(event, **details)` lets the observer know."""
        self._world, self._tell = world, tell
        degree = world.graph.degree
        self.all = [
            Shard(_name(p, truth), nodes.tolist(), int(degree[nodes].sum()), Sender(session, keys.state(p)))
            for p, nodes in enumerate(truth.shards)
        ]
        self._sizes = [len(shard.nodes) for shard in self.all]
        self.missing: set[int] = set()
        """those whose input(t) has not come"""
        self.deserted = False
        """every shard that should be there is lost: t waits for one of them"""
        self._until: list[tuple[Shard, Callable[[], bool]]] = []
        """what state(t) is held for besides its turn: shards, and what must be true of them"""
        self._called_at = time.monotonic()

    # Between two steps.

    def attend(self) -> None:
        """Before step t: who died meanwhile is lost, and of the lost who is there again is taken back."""
        world = self._world
        for p, shard in enumerate(self.all):
            if shard.fault is not None:
                if shard.found:
                    self._take_back(p, shard, shard.fault)
            elif (shard.gone or shard.life <= shard.died) and world.wanted(p, world.t):
                self.lose(p, "its process died")
            shard.gone = False
        lost = any(shard.fault is not None for shard in self.all)
        # Nobody would act at t, nor at t + 1 who is taken back, and not because the faults of the file say so.
        self.deserted = lost and not any(
            shard.fault is None and (world.wanted(p, world.t) or (shard.returning and world.wanted(p, world.t + 1)))
            for p, shard in enumerate(self.all)
        )

    def prepare(self) -> None:
        """At the beginning of step t: what each is told, and who is waited for."""
        self._until.clear()
        if (x := self._world.quiet_states) is not None:
            self.missing.update(range(len(self.all)))
            for shard, message in zip(self.all, encode_quiet_states(self._world.t, x, self._sizes), strict=True):
                shard.messages = [message]
            return
        for p, (shard, (state, record)) in enumerate(zip(self.all, self._world.states(), strict=True)):
            shard.messages = [] if record is None else [encode_record(record)]
            if state is not None:
                self.missing.add(p)
                shard.messages.append(encode_state(*state))
            elif shard.fault is None and not shard.external:
                self._await_crash(p, shard)

    def _await_crash(self, p: int, shard: Shard) -> None:
        """Nobody of this shard is there at t: hold the step until its process is gone, or there again if it must."""
        world, life = self._world, shard.life
        dies = world.wanted(p, world.t - 1) and shard.died < life and not shard.returning
        if dies:
            self._tell("kill", shard=p, life=life, restart=world.comes_back(p))
            self._until.append((shard, lambda: shard.died >= life))
        # A crash may end with the run: nobody is awaited for a step that never comes.
        if world.t + 1 < world.steps and world.wanted(p, world.t + 1):
            if not shard.ready:
                self._tell("revive", shard=p)
            # The next life may be over before the state leaves: then it is lost at t + 1.
            then = life + (dies or life <= shard.died)
            self._until.append((shard, lambda: shard.ready or shard.died >= then))

    @property
    def held_for(self) -> list[Shard]:
        """Those that must be gone, or there, before state(t) may leave."""
        return [shard for shard, is_true in self._until if not is_true()]

    # Lost, and back.

    def lose(self, p: int, why: str) -> None:
        """Go on without a shard: from t on it has crashed, as if a fault of the file had said so."""
        shard, world = self.all[p], self._world
        shard.fault, shard.back = world.fault_count, False
        world.fault_count += 1
        self.missing.discard(p)
        shard.messages.clear()
        world.faults.add([Effect(shard.fault, "crash", tuple(shard.nodes), world.t, FOREVER)])
        self._tell("lost", shard=p, fault=shard.fault, who=shard.name, cause=why)

    def _take_back(self, p: int, shard: Shard, fault: int) -> None:
        """A lost shard that is there again hears its neighbours from t on, and acts from t + 1 on."""
        at = self._world.t + 1
        self._world.faults.end(fault, at)
        self._tell("back", shard=p, fault=fault, who=shard.name, at=at)
        shard.fault, shard.returning = None, True

    def call_the_lost(self) -> None:
        """Who was lost by the deadline may be there again: it answers a state of a step that never comes."""
        if time.monotonic() - self._called_at < RESEND_AFTER_S:
            return
        self._called_at = time.monotonic()
        for shard in self.all:
            if shard.fault is not None and shard.died < shard.life:
                nothing = np.full(len(shard.nodes), np.nan)
                shard.state.put(encode_state(FOREVER, nothing, bytes(shard.incidences)))

    # What becomes of their processes.

    def see(self, p: int, life: int, there: bool) -> None:
        """The token of a life came or went."""
        shard = self.all[p]
        if there:
            shard.seen = max(shard.seen, life)
        if life >= shard.life:
            shard.alive, shard.claimed_until = there, 0.0
            shard.back = shard.back or life > shard.life
            shard.life = life

    def end(self, p: int, life: int, running: bool) -> None:
        """A life is over; if the run is not, who was waited for at this step is lost now, and others at the next."""
        shard = self.all[p]
        if life <= shard.died:
            return
        shard.died, shard.life = life, max(shard.life, life)
        if shard.fault is None and running:
            if p in self.missing:
                self.lose(p, "its process died")
            else:
                shard.gone = self._world.wanted(p, self._world.t)


def _name(p: int, truth: Truth) -> str:
    """What messages call a shard."""
    ids = [str(truth.ids[k]) for k in truth.shards[p]]
    if len(ids) == 1:
        return f"agent {ids[0]}"
    return f"shard {p} of agents {', '.join(ids[:4])}{', …' if len(ids) > 4 else ''}"
