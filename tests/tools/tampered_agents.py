"""Agents that break their law or their sample log in one way each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.samples import LateRows
from hedgerow.agents.shard import Shard
from hedgerow.agents.view import View
from hedgerow.wire.message import TAKEN, Flag, Flags, Link, State


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


class ZeroForMissing(Shard):
    """Takes an input that is missing for 0."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._floats = None  # floats would make the steps with gaps
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
        self._floats = None
        samples, last = self._samples, np.zeros(1 + sum(peer.receives for peer in self.peers))

        def flow(u: Array, bits: Flags) -> Array:
            last[:] = np.where(np.isnan(u), last, u)
            difference = np.where(bits & Flag.OPEN, last[samples._own] - last[samples._other], 0.0)
            return samples._sums(difference).astype(float, copy=False)

        samples._flow = flow  # type: ignore[method-assign]


class NoBackfill(Shard):
    """Throws away rows that come late."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._floats = None

    def _received(self, c: int, links: Sequence[Link | None], start: int, stop: int) -> LateRows:
        return super()._received(c, links, start, stop)._replace(stop=start, inputs=np.empty(0))


class BackfillReversed(Shard):
    """Learns late samples in the reverse order of their steps."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._floats = None
        samples = self._samples

        def learn_onward(since: Mapping[int, int], until: int) -> None:
            start, history = min(since.values()), samples._history
            x, u, bits = (rows(start, until + 1) for rows in (history.x, history.u, history.bits))
            for step in reversed(range(until - start)):
                samples._learn(x[step], samples._flow(u[step], bits[step]), x[step + 1])

        samples._learn_onward = learn_onward  # type: ignore[method-assign]


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
        self.used = b""
        return u


class DeniedReceipt(Shard):
    """Reports at step 3 that one row is missing."""

    def answer(self, state: State) -> Array:
        u = super().answer(state)
        if state.t == 3:
            self.used = bytes([Flag.OPEN, *[TAKEN] * (self.m - 1)])
        return u


class MessageLost(Shard):
    """Continues without a neighbour's message of step 2."""

    def receive(self, peer: int, link: Link) -> None:
        if link.t == 2 and not peer:
            link = link._replace(u=np.full(len(link.u) // 8, np.nan).tobytes())
        super().receive(peer, link)


class MessageChanged(Shard):
    """Gets a neighbour's input of step 2 that is doubled."""

    def receive(self, peer: int, link: Link) -> None:
        if link.t == 2 and not peer:
            link = link._replace(u=(2 * np.frombuffer(link.u)).tobytes())
        super().receive(peer, link)


class MessageTwice(Shard):
    """Gets every message twice."""

    def receive(self, peer: int, link: Link) -> None:
        super().receive(peer, link)
        super().receive(peer, link)


class MessagesLate(Shard):
    """Gets the messages of a step in the reverse order, as it needs them."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._held: list[tuple[int, Link]] = []

    def receive(self, peer: int, link: Link) -> None:
        self._held.append((peer, link))

    def answer(self, state: State) -> Array:
        for peer, link in reversed(self._held):
            super().receive(peer, link)
        self._held.clear()
        return super().answer(state)
