"""The optimal H-infinity controller with a known model, equation (8) of the paper.

    u_i = b x_i / (a_i - 1)

Lidström and Rantzer, "Optimal H-infinity State Feedback for Systems with Symmetric and Hurwitz State Matrix", ACC 2016.
It is the oracle: the operator gives every node its true a as the only candidate. It is right while that a is the truth.
It fails after the truth jumps, because it does not learn.
"""

from __future__ import annotations

from typing import ClassVar

from hedgerow.agents.law import Minimax


class HInf(Minimax):
    """The paper's law with the true a as the only candidate of each node."""

    equation: ClassVar[str] = "ahat = a, the truth, from the operator (8)"
