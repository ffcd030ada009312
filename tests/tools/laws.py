"""Laws for tests; `tests.tools.laws:NAME` in a topology."""

from __future__ import annotations

import numpy as np

from hedgerow.agents.law import Array, control
from hedgerow.agents.local import Local, Received


class Curious:
    """Asks for all local data, and uses all of it for u, ahat and the margin."""

    def __init__(self, b: float, candidates: Array, *, weight: float = 0.25, local: Local) -> None:
        self.b, self.weight, self.local = b, weight, local
        self.memory = np.zeros((2, candidates.shape[1]))

    def act(self, x: Array, now: Received) -> Array:
        seen = np.where(np.isnan(now.x), 7.0, now.x) + 0.1 * np.where(np.isnan(now.u), 3.0, now.u) + 0.01 * now.step
        mean = self.local.sums(self.local.weight * seen) / np.maximum(self.local.degree, 1)
        drawn = self.local.draw(now.t)
        return control(self.b, x + 1e-3 * self.weight * (mean + drawn), np.full(len(x), 0.5))

    def learn(self, x: Array, flow: Array, x_next: Array, sample: Received) -> None:
        known = np.isfinite(x * flow * x_next) & sample.nodes
        summed = self.local.sums(np.nan_to_num(sample.x) + 2 * np.nan_to_num(sample.u) + sample.step)
        self.memory[0] = np.where(known, 0.9 * self.memory[0] + summed + sample.t, self.memory[0])
        self.memory[1] += known

    def report(self) -> Array:
        return self.memory


class LeastSquares:
    """Acts by equation (6) on the least-squares a itself, as far as the candidates reach."""

    def __init__(self, b: float, candidates: Array) -> None:
        self.b = b
        self.low, self.high = np.nanmin(candidates, axis=0), np.nanmax(candidates, axis=0)
        self.memory = np.zeros((2, candidates.shape[1]))

    @property
    def a(self) -> Array:
        sxx, sxy = self.memory
        return np.asarray(np.clip(np.divide(sxy, sxx, out=self.low.copy(), where=sxx > 0), self.low, self.high))

    def act(self, x: Array) -> Array:
        return control(self.b, x, self.a)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        y = x_next - self.b * flow
        self.memory += np.where(np.isfinite(flow), [x * x, x * y], 0.0)

    def report(self) -> Array:
        return np.stack([self.a, np.full(len(self.a), np.nan)])


class Damped:
    """Acts with half the input of equation (6) on the smallest candidate, and learns nothing."""

    def __init__(self, b: float, candidates: Array) -> None:
        self.gain = 0.5 * b / (1.0 - np.nanmin(candidates, axis=0))
        self.memory = np.empty((0, candidates.shape[1]))

    def act(self, x: Array) -> Array:
        return np.asarray(-self.gain * x)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        pass

    def report(self) -> Array:
        return np.full((2, len(self.gain)), np.nan)
