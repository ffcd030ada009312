"""The number of examples of a property: a share of them in every run of the suite, and all of them on request.

`HEDGEROW_ALL_EXAMPLES=1 pytest` tries all. Hypothesis draws new examples in each run, so the suite finds in some runs
what it would find in one long run.
"""

from __future__ import annotations

import os

EVERY = 1 if os.environ.get("HEDGEROW_ALL_EXAMPLES") else 2


def examples(number: int) -> int:
    """Return how many of `number` examples this run tries."""
    return -(-number // EVERY)
