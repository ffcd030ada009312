"""Acts by equation (6) on the least-squares a itself, as far as the candidates reach."""

import numpy as np

from hedgerow.agents.law import Array, control


class LeastSquares:
    def __init__(self, b: float, candidates: Array) -> None:
        self.b = b
        self.low, self.high = np.nanmin(candidates, axis=0), np.nanmax(candidates, axis=0)
        self.memory = np.zeros((2, candidates.shape[1]))  # Sxx and Sxy

    @property
    def a(self) -> Array:
        sxx, sxy = self.memory
        return np.clip(np.divide(sxy, sxx, out=self.low.copy(), where=sxx > 0), self.low, self.high)

    def act(self, x: Array) -> Array:
        return control(self.b, x, self.a)

    def learn(self, x: Array, flow: Array, x_next: Array) -> None:
        y = x_next - self.b * flow
        self.memory += np.where(np.isfinite(flow), [x * x, x * y], 0.0)

    def report(self) -> Array:
        return np.stack([self.a, np.full(len(self.a), np.nan)])
