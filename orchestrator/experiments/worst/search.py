"""The attacks: populations of disturbances that improve by differential evolution and by power steps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hedgerow.orchestrator.experiments.worst.loop import NONE, Breaks, Scene, ascend, play
from hedgerow.topologies.graph import Array

SETTLING = 150
"""Steps in which the run of a constant disturbance settles."""
CONSTANT = 0
"""The length of an attack that stays constant."""


@dataclass
class Island:
    """One population: disturbances of some steps, or constant ones, under some faults."""

    length: int
    """number of steps of each disturbance; CONSTANT for constant ones"""
    members: Array
    """(P, T, n); of constant ones T is 1"""
    breaks: Breaks = NONE
    score: Array = field(default_factory=lambda: np.empty(0))
    """gain squared: of constant ones the settled value"""
    steps: Array = field(default_factory=lambda: np.empty(0))
    """number of steps after which a run has that gain"""
    generation: int = 0

    @classmethod
    def new(cls, scene: Scene, length: int, size: int, rng: np.random.Generator, breaks: Breaks = NONE) -> Island:
        """Return a population that was drawn at random; localised disturbances are among them."""
        n = len(scene.a)
        steps = max(1, length)
        members = rng.standard_normal((size, steps, n))
        # Half of them are one pattern of the nodes with a time course, which is sparse; some of one sign.
        half = size // 2
        course = rng.standard_normal((half, steps, 1)) * (rng.random((half, steps, 1)) < 0.6)
        members[:half] = course * rng.standard_normal((half, 1, n)) + 0.01 * members[:half]
        members[: half // 2] *= rng.random((half // 2, 1, n)) < 0.5
        members[::3] = np.abs(members[::3])
        return cls(length, members, breaks)

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
        if self.length != CONSTANT:
            played = play(scene, members, self.breaks)
            return *played.gains(), played
        played = play(scene, members, self.breaks, SETTLING)
        energy = np.square(members[:, 0]).sum(axis=1)
        third = played.theta[-SETTLING // 3 :]
        spread = (third.max(axis=0) - third.min(axis=0)).max(axis=1)
        settled = played.sound[-1] & (spread < 1e-6) & (energy > 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(settled, played.cost[-1] / energy, 0.0), np.full(len(members), SETTLING), played

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
            case 2 if self.length != CONSTANT:
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
        size, steps, _ = self.members.shape
        base = np.where(rng.random(size)[:, None, None] < 0.5, self.members[self.best], self.members)
        time = np.arange(steps)
        later = time[None, :] - rng.integers(0, steps, size)[:, None]
        echo = np.where(later[:, :, None] >= 0, np.take_along_axis(base, later.clip(0)[:, :, None], axis=1), 0.0)
        own, copied = (rng.choice([-1.0, 0.0, 0.3, 1.0], size) * rng.uniform(0.3, 1.5, size) for _ in range(2))
        own[::2] = 1.0
        added = own[:, None, None] * base + copied[:, None, None] * echo
        since = time[None, :] >= rng.integers(0, steps, size)[:, None]
        factor = rng.choice([-1.0, 0.0, 0.5, 2.0], size)[:, None]
        scaled = base * np.where(since, factor, 1.0)[:, :, None]
        return np.where(rng.random(size)[:, None, None] < 0.6, added, scaled)

    def _power(self, scene: Scene, played: Any, steps: Array) -> Array:
        if self.length != CONSTANT:
            return ascend(scene, played, steps.astype(np.int64), self.breaks)
        # Of a constant disturbance the sum over the steps is what counts, and it tends to G'G w.
        along = ascend(scene, played, np.full(len(self.members), SETTLING), self.breaks)
        total = along.sum(axis=1, keepdims=True)
        size = np.sqrt(np.square(total).sum(axis=2, keepdims=True))
        own = np.sqrt(np.square(self.members).sum(axis=2, keepdims=True))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(size > 0, total * own / size, self.members)
