"""The exponential function of numbers that are not positive, with the same bits on every machine.

NumPy's and the C library's `exp` differ in their last bit from one processor to another, and a run would then not
repeat. This one uses + - * and exact scaling, each as a separate NumPy call, so no compiler can fuse them.
"""

from __future__ import annotations

import numpy as np

from hedgerow.agents.law import Array

LEAST = -708.0
"""Below it, the result is 0: it would be a subnormal number."""
PER_LOG_2 = 1.4426950408889634
LOG_2_HIGH, LOG_2_LOW = 0.6931471803691238, 1.9082149292705877e-10
"""log 2 in two parts; the first has so few digits that its product with a whole number below 1024 is exact"""
SERIES = (
    *(1 / 6227020800, 1 / 479001600, 1 / 39916800, 1 / 3628800, 1 / 362880, 1 / 40320, 1 / 5040),
    *(1 / 720, 1 / 120, 1 / 24, 1 / 6, 0.5, 1.0, 1.0),
)
"""1/13!, …, 1/0!: on |r| <= 0.35 the next term is below 1e-17"""


def exp(x: Array) -> Array:
    """Return e^x of x <= 0, of any shape, to about 2e-16 of it; 0 where x < -708, -inf included."""
    tiny = x < LEAST
    x = np.where(tiny, 0.0, x)
    k = np.floor(x * PER_LOG_2 + 0.5)
    r = x - k * LOG_2_HIGH
    r -= k * LOG_2_LOW
    total = np.full_like(r, SERIES[0])
    for coefficient in SERIES[1:]:
        total *= r
        total += coefficient
    found: Array = np.ldexp(total, k.astype(np.int32))
    found[tiny] = 0.0
    return found
