"""Changes to agents, plant and network that a verdict must find, and the table of its results.

python -m tests.tools.tampering --write     # the table of docs/reliability.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.samples import LateRows
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.metrics.replay import Replay
from hedgerow.orchestrator.metrics.verdict import Ending, Verdict, judge
from hedgerow.orchestrator.runs import reference
from hedgerow.plant.disturbance import Disturbance
from hedgerow.plant.faults import ActiveFaults, Faults
from hedgerow.plant.truth import Truth
from hedgerow.plant.world import World
from hedgerow.topologies.effects import Effect
from hedgerow.topologies.graph import Mask
from hedgerow.topologies.schema import Topology
from hedgerow.wire.codec import TAKEN, End, Flag, Flags, Link, State, Telemetry
from tests.tools.networks import Trajectory, gathered, read
from tests.tools.schedules import with_faults

PAGE = Path(__file__).parents[2] / "docs" / "reliability.md"
BEGIN, STOP = "<!-- tampering table: python -m tests.tools.tampering --write -->", "<!-- end of tampering table -->"

NODE = 2
"""the id of the changed agent"""
TEXT = """
name: watched
b: 0.1
steps: 30
seed: 7
defaults: {candidates: [0.3, 0.5, 0.7, 0.9], disturbance: {kind: white, std: 0.5}}
nodes:
  1: {a: 0.7, x0: 5}
  2: {a: 0.5, x0: -3}
  3: {a: 0.9, x0: 8}
  4: {a: 0.3, x0: 2}
  5: {a: 0.7, x0: -6}
edges: [[1, 2], [2, 3], [3, 4], [4, 5], [1, 5], [1, 3]]
"""
FAULTS: list[dict[str, Any]] = [
    {"kind": "drop", "from": 1, "to": 2, "steps": [4, 8]},
    {"kind": "delay", "from": 3, "to": 2, "by": 3, "steps": [10, 16]},
    {"kind": "cut", "edge": [1, 2], "steps": [17, 19]},
    {"kind": "sensor", "node": 2, "steps": [19, 21]},
    {"kind": "actuator", "node": 2, "steps": [21, 23]},
    {"kind": "crash", "node": 2, "at": 23, "restart_after": 3},
    {"kind": "jump", "node": 2, "at": 28, "a": 0.9},
]
WATCHED = with_faults(read(TEXT), FAULTS)
FORGETFUL = with_faults(WATCHED, FAULTS, backfill=False)
"""The same network without back-filling: a crashed agent begins with no memory."""
SILENT = with_faults(WATCHED, [{"kind": "drop", "from": 1, "to": 2, "steps": [1, 15]}])
"""The same network with one long gap: many samples are learned late."""
UNLEARNING = [WATCHED.model_copy(update={"law": law}) for law in ("nominal", "hinf")]
"""The same network under laws that learn nothing: no input depends on a delay."""

Rows = Callable[[list[Telemetry], End], tuple[list[Telemetry], End | None]]


@dataclass(frozen=True)
class Tampering:
    """One change, and where it is made."""

    name: str
    where: str
    law: type[Minimax] | None = None
    """the law of the changed agent"""
    shard: type[Shard] | None = None
    """the changed agent without its law"""
    world: type[World] | None = None
    rows: Rows | None = None
    """the telemetry that arrives instead of the sent one"""
    topology: Topology = WATCHED

    def run(self) -> Trajectory:
        """The telemetry that the plant sends."""
        topology = self.topology
        shards = layout(topology, None)
        views = views_of(topology, shards)
        if self.law is not None:
            k = topology.position(NODE)
            views[k] = replace(views[k], law=f"{__name__}:{self.law.__name__}")
        changed = self.shard or Shard

        def shard(view: View) -> Shard:
            return (changed if view.ids[0] == NODE else Shard)(view)

        with mock.patch.multiple(reference, World=self.world or World, Shard=shard), np.errstate(all="ignore"):
            return gathered(reference.run(truth_of(topology, shards), views))

    def verdict(self) -> Verdict:
        """Return the verdict of such a run."""
        ran = self.run()
        rows, end = (ran.rows, ran.end) if self.rows is None else self.rows(list(ran.rows), ran.end)
        return verdict(self.topology, rows, end)


def verdict(topology: Topology, rows: Sequence[Telemetry], end: End | None) -> Verdict:
    """Return the verdict of an observer and a replay of these rows."""
    observer, replay = Observer(topology), Replay(topology)
    for row in rows:
        with np.errstate(all="ignore"):
            observer.take([row])
        replay.take([row])
    if end is not None:
        observer.finish(end)
    return judge(topology, observer, Ending("run", "in-process", 0, replay=replay))


# Agents: their law.


class SecondBest(Minimax):
    """Takes the candidate that fits second best."""

    def _choose(self) -> None:
        super()._choose()
        self.ahat[:] = self.candidates[np.argsort(self.J, axis=0, kind="stable")[1], self._nodes]


class NeverLearns(Minimax):
    """Keeps its first estimate."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None: ...


class LearnsTwice(Minimax):
    """Counts every sample twice."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        super().learn(x, flow, x_next)
        super().learn(x, flow, x_next)


class NoFlow(Minimax):
    """Learns as if it had no neighbours."""

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        super().learn(x, np.where(np.isnan(flow), flow, 0.0), x_next)


class LastOfTies(Minimax):
    """Takes the last of equally good candidates."""

    def _choose(self) -> None:
        super()._choose()
        last = len(self.J) - 1 - self.J[::-1].argmin(axis=0)
        self.ahat[:] = self.candidates[last, self._nodes]


class OneUlpInput(Minimax):
    """Sends inputs that are the next float."""

    def act(self, x: Array) -> Array:
        return np.nextafter(super().act(x), np.inf)


class HalfState(Minimax):
    """Acts on half of its state."""

    def act(self, x: Array) -> Array:
        return super().act(0.5 * x)


class ForgedEstimate(Minimax):
    """Acts rightly, and reports another estimate."""

    def report(self) -> Array:
        return np.stack([np.where(self.ahat == 0.5, 0.7, 0.5), self.margin])


class ForgedMargin(Minimax):
    """Acts rightly, and reports a margin that is larger by a millionth."""

    def report(self) -> Array:
        return np.stack([self.ahat, self.margin * (1 + 1e-6)])


class OtherCandidates(Minimax):
    """Chooses from a list that is off by 1e-9."""

    def __init__(self, b: float, candidates: Array) -> None:
        super().__init__(b, candidates + 1e-9)


# Agents: the sample log around it.


class ZeroForMissing(Shard):
    """Takes an input that is missing for 0."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        samples = self._samples

        def flow(u: Array, bits: Flags) -> Array:
            held = np.where(np.isnan(u), 0.0, u)
            difference = np.where(bits & Flag.OPEN, held[samples._own] - held[samples._other], 0.0)
            return samples._sums(difference).astype(float, copy=False)

        samples._flow = flow  # type: ignore[method-assign]


class HeldForMissing(Shard):
    """Takes the last input that came for one that is missing."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        samples, last = self._samples, np.zeros(1 + sum(self.hears))

        def flow(u: Array, bits: Flags) -> Array:
            last[:] = np.where(np.isnan(u), last, u)
            difference = np.where(bits & Flag.OPEN, last[samples._own] - last[samples._other], 0.0)
            return samples._sums(difference).astype(float, copy=False)

        samples._flow = flow  # type: ignore[method-assign]


class NoBackfill(Shard):
    """Throws away rows that come late."""

    def _came(self, c: int, links: Sequence[Link | None], start: int, stop: int) -> LateRows:
        return super()._came(c, links, start, stop)._replace(stop=start, inputs=np.empty(0))


class BackfillReversed(Shard):
    """Learns late samples in the reverse order of their steps."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        samples = self._samples

        def learn_from(k: int, until: int, nodes: list[int]) -> None:
            start, memory, _ = samples._marks[k]
            samples._law.memory = memory.copy()
            history = samples._history
            x, u, bits = (rows(start, until + 1) for rows in (history.x, history.u, history.bits))
            for step in reversed(range(until - start)):
                samples._learn(x[step], samples._flow(u[step], bits[step]), x[step + 1])

        samples._learn_from = learn_from  # type: ignore[method-assign]


class KeepsMemory(Shard):
    """Remembers what it knew before it crashed."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._samples._forget = lambda nodes: None  # type: ignore[method-assign]  # noqa: ARG005


class ActsBlind(Shard):
    """Acts on its last state while its sensor is lost."""

    def answer(self, state: State) -> Array:
        x = np.where(np.isnan(state.x), self.x, state.x) if state.t else state.x
        return super().answer(state._replace(x=x))


class ForgedReceipt(Shard):
    """Reports every row as received in time."""

    def answer(self, state: State) -> Array:
        u = super().answer(state)
        self.took = b""
        return u


class DeniedReceipt(Shard):
    """Reports at step 3 that one row is missing."""

    def answer(self, state: State) -> Array:
        u = super().answer(state)
        if state.t == 3:
            self.took = bytes([Flag.OPEN, *[TAKEN] * (self.m - 1)])
        return u


class MessageLost(Shard):
    """Continues without a neighbour's message of step 2."""

    def hear(self, peer: int, link: Link) -> None:
        if link.t == 2 and not peer:
            link = link._replace(u=np.full(len(link.u) // 8, np.nan).tobytes())
        super().hear(peer, link)


class MessageChanged(Shard):
    """Gets a neighbour's input of step 2 that is doubled."""

    def hear(self, peer: int, link: Link) -> None:
        if link.t == 2 and not peer:
            link = link._replace(u=(2 * np.frombuffer(link.u)).tobytes())
        super().hear(peer, link)


class MessageTwice(Shard):
    """Gets every message twice."""

    def hear(self, peer: int, link: Link) -> None:
        super().hear(peer, link)
        super().hear(peer, link)


class MessagesLate(Shard):
    """Gets the messages of a step in the reverse order, as it needs them."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._held: list[tuple[int, Link]] = []

    def hear(self, peer: int, link: Link) -> None:
        self._held.append((peer, link))

    def answer(self, state: State) -> Array:
        for peer, link in reversed(self._held):
            super().hear(peer, link)
        self._held.clear()
        return super().answer(state)


# The plant.


class _Changed(World):
    """A plant with a changed truth, changed faults or changed disturbances."""

    def __init__(self, truth: Truth) -> None:
        super().__init__(self.told(truth))
        self.disturb(truth)
        if self.none_of:
            kept = [one for one in self.faults.effects if one.kind != self.none_of]
            self.faults = Faults(map(self.other, kept), self.graph, truth.ids, truth.seed)
        else:
            self.faults = Faults(map(self.other, self.faults.effects), self.graph, truth.ids, truth.seed)

    none_of = ""
    """the kind of fault that does not happen"""

    def told(self, truth: Truth) -> Truth:
        return truth

    def other(self, effect: Effect) -> Effect:
        return effect

    def disturb(self, truth: Truth, /) -> None: ...

    def at_w(self, change: Callable[[Array, int], Array]) -> None:
        at = self._disturbance.at
        self._disturbance.at = lambda t, x=None, a=None: change(at(t, x, a), t)  # type: ignore[method-assign]


class StartOff(_Changed):
    """Begins 1 % off."""

    def told(self, truth: Truth) -> Truth:
        return replace(truth, x0=truth.x0 * np.where(truth.ids == NODE, 1.01, 1.0))


class LargerW(_Changed):
    """Scales w by 1 + 1e-6."""

    def disturb(self, _: Truth, /) -> None:
        self.at_w(lambda w, _: w * (1 + 1e-6))


class OtherSeed(_Changed):
    """Draws w by another seed."""

    def disturb(self, truth: Truth, /) -> None:
        self._disturbance = Disturbance(truth.disturbance, truth.ids, truth.seed + 1)


class LateW(_Changed):
    """Applies w one step late."""

    def disturb(self, _: Truth, /) -> None:
        at = self._disturbance.at
        self._disturbance.at = lambda t, x=None, a=None: at(max(0, t - 1), x, a)  # type: ignore[method-assign]


class OneUlpMotion(_Changed):
    """Moves one node to the next float, once."""

    def advance(self, u: Array) -> None:
        super().advance(u)
        if self.t == 10:
            self.x = np.where(np.arange(self.graph.n) == NODE - 1, np.nextafter(self.x, np.inf), self.x)


class OtherA(_Changed):
    """Moves by an a that is off by 1e-12."""

    def told(self, truth: Truth) -> Truth:
        return replace(truth, a=truth.a + np.where(truth.ids == NODE, 1e-12, 0.0))


class OtherB(_Changed):
    """Moves by another gain b."""

    def told(self, truth: Truth) -> Truth:
        return replace(truth, b=truth.b * (1 + 1e-9))


class ShorterDelay(_Changed):
    """Delays by 2 steps in place of 3."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, by=2) if effect.kind == "delay" else effect


class NoDelay(_Changed):
    """Does not delay."""

    none_of = "delay"


class NoDrop(_Changed):
    """Does not drop."""

    none_of = "drop"


class NoCut(_Changed):
    """Does not cut."""

    none_of = "cut"


class NoSensorFault(_Changed):
    """Does not lose the readings."""

    none_of = "sensor"


class NoActuatorFault(_Changed):
    """Lets inputs act that should be lost."""

    none_of = "actuator"


class NoCrash(_Changed):
    """Does not let the agent crash."""

    none_of = "crash"


class NoJump(_Changed):
    """Keeps the old a."""

    none_of = "jump"


class LateJump(_Changed):
    """Changes a one step late."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, start=effect.start + 1) if effect.kind == "jump" else effect


class LongerCrash(_Changed):
    """Lets the agent come back one step late."""

    def other(self, effect: Effect) -> Effect:
        return replace(effect, stop=effect.stop + 1) if effect.kind == "crash" else effect


class OtherLots(_Changed):
    """Drops a message without a fault in the file."""

    def begin(self) -> None:
        at = self.faults.at

        def lost(t: int) -> ActiveFaults:
            wrong = at(t)
            if t != 12:
                return wrong
            dropped: Mask = np.arange(len(self.graph.node)) == int(self.graph.first[NODE - 1])
            return replace(wrong, lost=dropped)

        self.faults.at = lost  # type: ignore[method-assign]
        super().begin()
        self.faults.at = at  # type: ignore[method-assign]


class OneSidedCut(_Changed):
    """Cuts the edge at one of its ends."""

    def advance(self, u: Array) -> None:
        super().advance(u)
        if self.t == 18:
            one_sided = self.b * (self._made.u[0] - self._made.u[1])
            self.x = self.x + np.where(np.arange(self.graph.n) == NODE - 1, -one_sided, 0.0)


class HeldInput(_Changed):
    """Lets the last input act where one is lost."""

    def __init__(self, truth: Truth) -> None:
        super().__init__(truth)
        self._last = np.zeros(self.graph.n)

    def advance(self, u: Array) -> None:
        self._last = np.where(np.isfinite(u), u, self._last)
        super().advance(self._last)


class EdgeToldOpen(_Changed):
    """Reports a closed edge as open."""

    def account(self, report: Array, took: Sequence[Any]) -> Telemetry:
        row = super().account(report, took)
        return row._replace(edge_open=np.ones_like(row.edge_open))


class ShortHistory(_Changed):
    """Keeps one past row in place of all."""

    def told(self, truth: Truth) -> Truth:
        return replace(truth, history=1)


# The wire between plant and observer.


def _row(rows: list[Telemetry], t: int, **columns: Any) -> list[Telemetry]:
    return [row._replace(**columns) if row.t == t else row for row in rows]


def _ulp(values: Array) -> Array:
    return np.where(np.arange(len(values)) == NODE - 1, np.nextafter(values, np.inf), values)


def twice(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One row comes twice."""
    return [*rows[:12], rows[11], *rows[12:]], end


def swapped(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """Two rows change places."""
    return [*rows[:11], rows[12], rows[11], *rows[13:]], end


def lost(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One row is lost."""
    return [*rows[:11], *rows[12:]], end


def no_end(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """The final state is lost."""
    return rows, None


def other_state(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One state is the next float."""
    return _row(rows, 11, x=_ulp(rows[11].x)), end


def other_input(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One input is the next float."""
    return _row(rows, 11, u=_ulp(rows[11].u)), end


def other_end(rows: list[Telemetry], end: End) -> tuple[list[Telemetry], End | None]:
    """One node of the final state is the next float."""
    return rows, end._replace(x=_ulp(end.x))


def _all() -> Iterable[Tampering]:
    for law in (
        SecondBest, NeverLearns, LearnsTwice, NoFlow, LastOfTies, OtherCandidates, HalfState, OneUlpInput,
        ForgedEstimate, ForgedMargin,
    ):  # fmt: skip
        yield Tampering(_said(law), "agent", law=law)
    for shard in (
        ZeroForMissing, HeldForMissing, NoBackfill, ActsBlind, ForgedReceipt, DeniedReceipt,
    ):  # fmt: skip
        yield Tampering(_said(shard), "agent", shard=shard)
    yield Tampering(_said(BackfillReversed), "agent", shard=BackfillReversed, topology=SILENT)
    yield Tampering(_said(KeepsMemory), "agent", shard=KeepsMemory, topology=FORGETFUL)
    for world in (
        StartOff, LargerW, OtherSeed, LateW, OneUlpMotion, OtherA, OtherB, ShorterDelay, NoDelay, NoDrop, NoCut,
        NoSensorFault, NoActuatorFault, NoCrash, LongerCrash, NoJump, LateJump, OtherLots, OneSidedCut, HeldInput,
        EdgeToldOpen, ShortHistory,
    ):  # fmt: skip
        yield Tampering(_said(world), "plant", world=world)
    for topology in UNLEARNING:
        yield Tampering(f"{_said(ShorterDelay)}, law `{topology.law}`", "plant", world=ShorterDelay, topology=topology)
    for mail in (MessageLost, MessageChanged, MessageTwice, MessagesLate):
        yield Tampering(_said(mail), "wire", shard=mail)
    for rows in (twice, swapped, lost, no_end, other_state, other_input, other_end):
        yield Tampering(_said(rows), "wire", rows=rows)


def _said(what: Any) -> str:
    return str(what.__doc__).strip().rstrip(".")


ALL = list(_all())


def told(tampering: Tampering) -> list[str]:
    """Return the row of the table: place, change, verdict, the first failed check, and its step and node."""
    content = tampering.verdict().content
    failed = {name: check for name, check in content["checks"].items() if not check["ok"]}
    named = [(name, check) for name, check in failed.items() if check.get("node") is not None]
    name, check = next(iter(named or failed.items()), ("", dict[str, Any]()))
    first = content["reasons"][0] if content["reasons"] and not failed else ""
    step, node = check.get("step"), check.get("node")
    equal = content["verdict"] == "valid" and tampering.run().same_bits(
        Tampering("", "", topology=tampering.topology).run()
    )
    verdict_ = "valid, equal to the bit" if equal else content["verdict"]
    return [
        tampering.where,
        tampering.name,
        verdict_,
        f"`{name}`" if name else first,
        "" if step is None else str(step),
        "" if node is None else str(node),
    ]


def table() -> list[str]:
    """The lines of the table."""
    head = ["where", "change", "verdict", "check", "step", "node"]
    lines = [head, ["---"] * len(head), *(told(one) for one in ALL)]
    return [f"| {' | '.join(line)} |" for line in lines]


def written() -> list[str]:
    """The table as the page has it."""
    return PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(STOP)[0].strip().splitlines()


if __name__ == "__main__":
    from tests.tools.tampering import PAGE, table  # the laws are loaded by the name of this module

    lines = "\n".join(table())
    print(lines)
    if "--write" in sys.argv:
        text = PAGE.read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{lines}\n{STOP}{rest.partition(STOP)[2]}", encoding="utf-8")
