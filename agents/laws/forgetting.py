"""The paper's law with exponential forgetting.

    J_i,m(t + 1) = decay J_i,m(t) + (a_m x_i(t) + b f_i(t) - x_i(t + 1))^2

Ljung and Söderström, Theory and Practice of Recursive Identification, MIT Press 1983, section 2.6.
It is right if the truth jumps: old samples stop counting after about 1/(1 - decay) steps. It fails if the truth stays
and the noise is large, because it never averages over more than that many samples. A missing sample does not decay J:
a gap forgets nothing.
"""

from __future__ import annotations

from typing import ClassVar

from hedgerow.agents.law import Array
from hedgerow.agents.laws.listed import Listed
from hedgerow.topologies.graph import Gain


class Forgetting(Listed):
    """The paper's law with costs that decay by a factor at every sample."""

    equation: ClassVar[str] = "J <- decay J + r^2"

    def __init__(self, b: Gain, candidates: Array, *, decay: float = 0.98) -> None:
        if not 0 < decay <= 1:
            raise ValueError(f"decay {decay} is not in (0, 1]")
        self.decay = decay
        super().__init__(b, candidates)

    def update(self, memory: Array, candidates: Array, x: Array, y: Array, t: int) -> None:  # noqa: ARG002
        """Decay J, and add the squared residuals."""
        residual = candidates * x
        residual -= y
        residual *= residual
        memory *= self.decay
        memory += residual
