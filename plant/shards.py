"""The shards of a run: which are present, which are lost, and the return of a lost one.

A shard is lost if its process dies or does not answer, and no fault of the file causes it. In the world this is one
additional crash fault of its nodes, which ends once the shard sends a message again. Every method runs with the plant's
lock held.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from hedgerow.plant.clock import RESEND_AFTER_S
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.effects import FOREVER, Effect
from hedgerow.wire import keys
from hedgerow.wire.codec import encode_quiet_states, encode_record, encode_state, kind_of
from hedgerow.wire.message import Kind
from hedgerow.wire.session import Sender
from hedgerow.wire.shared_steps import PLANT, SharedSteps, open_steps


@dataclass
class Shard:
    """One agent process as the plant sees it."""

    name: str
    """its name in messages"""
    nodes: Sequence[int]
    incidences: int
    state: Sender
    messages: list[bytes] = field(default_factory=list)
    """its messages of this step"""
    life: int = -1
    """the number of its restarts; -1 before its token was seen"""
    alive: bool = False
    """True while its token is present"""
    seen: int = -1
    """the last life with a token: that process had reached the router"""
    died: int = -1
    """the last life that ended"""
    gone: bool = False
    """True if that life was needed, and the step after its end has not begun"""
    fault: int | None = None
    """if lost: the number of its crash in the list of faults"""
    back: bool = False
    """True if it has sent a message since then"""
    returning: bool = False
    """True if it was lost and has not acted since its return"""
    final_report: dict[str, Any] | None = None
    """the messages that it sent and received, by key"""
    external: bool = False
    """True if another program restarts the process, and not `up`."""
    claim: int = -1
    """the number of the process that last received this place"""
    claimed_until: float = 0.0
    """the end of the reservation for that process, which is not there yet"""
    memory: SharedSteps | None = None
    """memory for its states and inputs; None if they travel in messages"""

    @property
    def ready(self) -> bool:
        """Return True if the shard can receive a state."""
        return self.alive and self.life > self.died

    @property
    def found(self) -> bool:
        """Return True if it was lost and is present again; a late input of an earlier life does not count."""
        return self.fault is not None and self.back and self.life > self.died

    def send(self, t: int) -> None:
        """Send its messages of step t."""
        # A life that cannot open the memory gets whole messages.
        memory = self.memory if self.memory is not None and self.memory.has(self.life + 1) else None
        for message in self.messages:
            self.state.put(memory.write(t, message) if memory and kind_of(message) == Kind.STATE else message)


class Shards:
    """All shards of a run, and what the current step waits for."""

    def __init__(
        self,
        truth: Truth,
        world: World,
        session: zenoh.Session,
        report: Callable[..., None],
        memories: Mapping[int, str],
    ) -> None:
        """Prepare the shards; `report(event, **details)` reports to the observer.

        `memories` are the paths of memory for states and inputs, by shard.
        """
        self._world, self._report = world, report
        degree = world.graph.degree
        self.all = [
            Shard(_name(p, truth), nodes.tolist(), int(degree[nodes].sum()), Sender(session, keys.state(p)))
            for p, nodes in enumerate(truth.shards)
        ]
        for p, path in memories.items():
            shard = self.all[p]
            shard.memory = open_steps(path, len(shard.nodes), shard.incidences, PLANT, plant=True)
        self._sizes = [len(shard.nodes) for shard in self.all]
        self.missing: set[int] = set()
        """the shards without an input(t)"""
        self.deserted = False
        """True if every shard that should be present is lost: t waits for one of them"""
        self._until: list[tuple[Shard, Callable[[], bool]]] = []
        """the shards that state(t) waits for, each with the condition that must hold"""
        self._called_at = time.monotonic()

    # Between two steps.

    def attend(self) -> None:
        """Update the shards before step t: processes that died are lost, and lost ones that are present again
        return.
        """
        world = self._world
        for p, shard in enumerate(self.all):
            if shard.fault is not None:
                if shard.found:
                    self._take_back(p, shard, shard.fault)
            elif (shard.gone or shard.life <= shard.died) and world.wanted(p, world.t):
                self.lose(p, "its process died")
            shard.gone = False
        lost = any(shard.fault is not None for shard in self.all)
        # No node acts at t, nor any returning node at t + 1, although the faults of the file do not cause this.
        self.deserted = lost and not any(
            shard.fault is None and (world.wanted(p, world.t) or (shard.returning and world.wanted(p, world.t + 1)))
            for p, shard in enumerate(self.all)
        )

    def prepare(self) -> None:
        """Prepare the messages of step t, and the set of shards to wait for."""
        self._until.clear()
        if (ready := self._world.ready_states) is not None:
            x, tails = ready
            self.missing.update(range(len(self.all)))
            starts = encode_quiet_states(self._world.t, x, self._sizes)
            for shard, start, tail in zip(self.all, starts, tails, strict=True):
                shard.messages = [start + tail if tail else start]
            return
        for p, (shard, (state, record)) in enumerate(zip(self.all, self._world.states(), strict=True)):
            shard.messages = [] if record is None else [encode_record(record)]
            if state is not None:
                self.missing.add(p)
                shard.messages.append(encode_state(*state))
            elif shard.fault is None and not shard.external:
                self._await_crash(p, shard)

    def _await_crash(self, p: int, shard: Shard) -> None:
        """Hold step t for a shard with no node present: until its process has ended, or is present again if it is
        needed.
        """
        world, life = self._world, shard.life
        dies = world.wanted(p, world.t - 1) and shard.died < life and not shard.returning
        if dies:
            self._report("kill", shard=p, life=life, restart=world.comes_back(p))
            self._until.append((shard, lambda: shard.died >= life))
        # A crash may last until the end of the run: do not wait for a step that never happens.
        if world.t + 1 < world.steps and world.wanted(p, world.t + 1):
            if not shard.ready:
                self._report("revive", shard=p)
            # The next life may end before the state leaves: then it is lost at t + 1.
            then = life + (dies or life <= shard.died)
            self._until.append((shard, lambda: shard.ready or shard.died >= then))

    @property
    def held_for(self) -> list[Shard]:
        """Return the shards that must end or appear before state(t) may leave."""
        return [shard for shard, is_true in self._until if not is_true()]

    # Losses and returns.

    def lose(self, p: int, why: str) -> None:
        """Continue without a shard: its nodes have crashed from t on, as after a crash fault of the file."""
        shard, world = self.all[p], self._world
        shard.fault, shard.back = world.fault_count, False
        world.fault_count += 1
        self.missing.discard(p)
        shard.messages.clear()
        world.faults.add([Effect(shard.fault, "crash", tuple(shard.nodes), world.t, FOREVER)])
        self._report("lost", shard=p, fault=shard.fault, who=shard.name, cause=why)

    def _take_back(self, p: int, shard: Shard, fault: int) -> None:
        """Let a lost shard return: it receives its neighbours' messages from t on, and acts from t + 1 on."""
        at = self._world.t + 1
        self._world.faults.end(fault, at)
        self._report("back", shard=p, fault=fault, who=shard.name, at=at)
        shard.fault, shard.returning = None, True

    def call_the_lost(self) -> None:
        """Call the shards that were lost by the deadline: they would answer a state of a step that never happens."""
        if time.monotonic() - self._called_at < RESEND_AFTER_S:
            return
        self._called_at = time.monotonic()
        for shard in self.all:
            if shard.fault is not None and shard.died < shard.life:
                nothing = np.full(len(shard.nodes), np.nan)
                shard.state.put(encode_state(FOREVER, nothing, bytes(shard.incidences)))

    # The fate of their processes.

    def see(self, p: int, life: int, there: bool) -> None:
        """Record that the token of a life appeared or vanished."""
        shard = self.all[p]
        if there:
            shard.seen = max(shard.seen, life)
        if life >= shard.life:
            shard.alive, shard.claimed_until = there, 0.0
            shard.back = shard.back or life > shard.life
            shard.life = life

    def end(self, p: int, life: int, running: bool) -> None:
        """Record the end of a life.

        In a running network, a shard that this step waits for is lost now, any other at the next step.
        """
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
    """Return the name of a shard in messages."""
    ids = [str(truth.ids[k]) for k in truth.shards[p]]
    if len(ids) == 1:
        return f"agent {ids[0]}"
    return f"shard {p} of agents {', '.join(ids[:4])}{', …' if len(ids) > 4 else ''}"
