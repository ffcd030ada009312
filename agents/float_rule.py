"""The rule of a law for one node in Python's floats: what the quiet step (agents.float_law) calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Memory = list[float]


class Sample(NamedTuple):
    """The sample of step t, and the state of step t + 1 to act on."""

    t: int
    x: float
    y: float
    """x(t + 1) - b f(t)"""
    bx: float
    """b x(t + 1)"""


Act = tuple[Memory, float, float, float]
"""the memory after the sample, u(t + 1), ahat, and the margin"""
Rule = Callable[[Memory, Sample], Act]
"""Learn a sample and act. The memory that it is given stays as it is. It may raise ArithmeticError."""
