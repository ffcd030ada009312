"""The attacks: populations of disturbances that improve by differential evolution and by power steps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hedgerow.orchestrator.experiments.worst.loop import NONE, Breaks, Scene, ascend, play
from hedgerow.orchestrator.experiments.worst.rest import LEAD, resting, steered
from hedgerow.topologies.graph import Array

SETTLING = 150
"""Steps in which the run of a constant disturbance settles."""


class Kind(NamedTuple):
    """The kind of a disturbance."""

    length: int
    """number of its values"""
    holds: bool
    """True if the last value stays"""


@dataclass
class Island:
    """One population: disturbances of some steps, under some faults."""

    holds: bool
    """True if a disturbance keeps its last value for ever; with one step it is constant"""
    members: Array
    """(P, T, n)"""
    breaks: Breaks = NONE
    score: Array = field(default_factory=lambda: np.empty(0))
    """gain squared: of one that holds the settled value"""
    steps: Array = field(default_factory=lambda: np.empty(0))
    """number of steps after which a run has that gain"""
    generation: int = 0

    @classmethod
    def new(cls, scene: Scene, kind: Kind, size: int, rng: np.random.Generator, breaks: Breaks = NONE) -> Island:
        """Return a population that was drawn at random; localised disturbances are among them."""
        n, steps = len(scene.a), kind.length
        members = rng.standard_normal((size, steps, n))
        # Half of them are one pattern of the nodes with a time course, which is sparse; some of one sign.
        half = size // 2
        pattern = rng.standard_normal((half, steps, 1)) * (rng.random((half, steps, 1)) < 0.6)
        members[:half] = pattern * rng.standard_normal((half, 1, n)) + 0.01 * members[:half]
        members[: half // 2] *= rng.random((half // 2, 1, n)) < 0.5
        members[::3] = np.abs(members[::3])
        if kind.holds:
            known = seeds(scene, kind, size // 3, rng) if not len(breaks) else members[:0]
            members[1 : 1 + len(known)] = known
            members[0] = scene.worst_of_oracle
        return cls(kind.holds, members, breaks)

    @property
    def kind(self) -> Kind:
        """Return the kind of the disturbances."""
        return Kind(self.members.shape[1], self.holds)

    @property
    def best(self) -> int:
        """Return the number of the member with the largest gain."""
        return int(self.score.argmax())

    def evolve(self, scene: Scene, rng: np.random.Generator) -> None:
        """Make one generation: a trial for each member, which replaces it if it is better."""
        if not len(self.score):
            self.score, self.steps, _ = self.judge(scene, self.members)
        trials = self._trials(scene, rng)
        score, steps, _ = self.judge(scene, trials)
        better = score > self.score
        self.members[better], self.score[better], self.steps[better] = trials[better], score[better], steps[better]
        self.generation += 1

    def judge(self, scene: Scene, members: Array) -> tuple[Array, Array, Any]:
        """Return the gains squared, the steps after which they are reached, and the runs."""
        if not self.holds:
            played = play(scene, members, self.breaks)
            gains, steps = played.gains()
            return gains, steps.astype(float), played
        played = play(scene, members, self.breaks, SETTLING)
        energy = np.square(members[:, -1]).sum(axis=1)
        settled = played.settled(SETTLING // 3, 1e-6) & (energy > 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(settled, played.cost[-1] / energy, 0.0), np.full(len(members), float(SETTLING)), played

    def _trials(self, scene: Scene, rng: np.random.Generator) -> Array:
        size = len(self.members)
        match self.generation % 5:
            case 0:
                _, steps, played = self.judge(scene, self.members)
                along = self._power(scene, played, steps)
                share = rng.choice([1.0, 0.5, 0.2, 0.05], size)[:, None, None]
                return (1 - share) * self.members + share * along
            case 1:
                # Small changes of the best and of the member itself.
                scale = 10 ** rng.uniform(-4, -0.3, size)[:, None, None]
                base = np.where(rng.random(size)[:, None, None] < 0.3, self.members[self.best], self.members)
                typical = np.sqrt(np.square(base).mean(axis=(1, 2), keepdims=True))
                few = rng.random(base.shape) < rng.choice([0.15, 0.5, 1.0], size)[:, None, None]
                return np.asarray(base + scale * typical * few * rng.standard_normal(base.shape))
            case 2 if not self.holds:
                return self._echoes(rng)
            case _:
                one, two, three = (rng.permutation(size) for _ in range(3))
                towards = rng.random(size)[:, None, None] < 0.4
                weight = rng.uniform(0.3, 0.9, size)[:, None, None]
                base = np.where(towards, self.members, self.members[three])
                pull = np.where(towards, weight * (self.members[self.best] - self.members), 0.0)
                mutant = base + pull + weight * (self.members[one] - self.members[two])
                crossed = rng.random(mutant.shape) < rng.uniform(0.2, 1.0, size)[:, None, None]
                return np.where(crossed, mutant, self.members)

    def _echoes(self, rng: np.random.Generator) -> Array:
        """Return members, or the best, with the sign, size or time of a part changed, or with a later copy added."""
        size, steps = len(self.members), self.members.shape[1]
        each = (size, 1, 1)
        base = np.where(rng.random(each) < 0.5, self.members[self.best], self.members)
        time = np.arange(steps)[None, :, None]
        later = time - rng.integers(0, steps, each)
        echo = np.where(later >= 0, np.take_along_axis(base, later.clip(0), axis=1), 0.0)
        own, copied = (rng.choice([-1.0, 0.0, 0.3, 1.0], each) * rng.uniform(0.3, 1.5, each) for _ in range(2))
        own[::2] = 1.0
        since = time >= rng.integers(0, steps, each)
        scaled = base * np.where(since, rng.choice([-1.0, 0.0, 0.5, 2.0], each), 1.0)
        return np.where(rng.random(each) < 0.6, own * base + copied * echo, scaled)

    def _power(self, scene: Scene, played: Any, steps: Array) -> Array:
        if not self.holds:
            return ascend(scene, played, steps.astype(np.int64), self.breaks)
        # The settled cost is a function of the last value alone, and its gradient tends to the sum over the steps.
        along = ascend(scene, played, np.full(len(self.members), SETTLING), self.breaks)
        total = along.sum(axis=1)
        size = np.sqrt(np.square(total).sum(axis=1))
        own = np.sqrt(np.square(self.members[:, -1]).sum(axis=1))
        with np.errstate(invalid="ignore", divide="ignore"):
            last = total * (own / size)[:, None]
        trials = self.members.copy()
        trials[:, -1] = np.where(np.isfinite(last), last, self.members[:, -1])
        return trials


def seeds(scene: Scene, kind: Kind, count: int, rng: np.random.Generator) -> Array:
    """Return up to `count` disturbances with a large settled gain of the last value, (K, T, n); a run confirms it."""
    if kind.length <= LEAD:
        found = resting(scene, count, rng, steered=False).w[:, None]
        return np.asarray(np.repeat(found, kind.length, axis=1))
    found = steered(scene, resting(scene, count, rng, steered=True), rng)
    return np.concatenate([found, np.repeat(found[:, -1:], kind.length - found.shape[1], axis=1)], axis=1)
