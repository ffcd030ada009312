"""How long shards take to answer: from when state(t) leaves to when input(t) is here, by the plant's own clock.

No clock of another machine has a part in it. An answer waits for the neighbours' messages of t - 1 too, so that a slow
link between two agents shows at both. What is repeated counts from its first time.
"""

from __future__ import annotations

import time
from array import array

import numpy as np

from hedgerow.wire.codec import Trips

TELL_EVERY_S = 0.5


class Stopwatch:
    """The round trips of every step; a step costs little more than a look at the clock for each shard."""

    def __init__(self, shards: int) -> None:
        self._nobody = array("d", [float("nan")] * shards)
        self.now = self._nobody[:]
        """this step's [s], NaN for who has not answered"""
        self._said = array("d")
        """of the steps since the observer was told"""
        self._told_at = time.monotonic()

    def end_step(self) -> bool:
        """The step is over; whether it is time to tell the observer."""
        self._said += self.now
        self.now = self._nobody[:]
        return time.monotonic() - self._told_at > TELL_EVERY_S

    def take_out(self, t: int) -> Trips | None:
        """The round trips since the last time, the last of them of step t; None if there were no steps."""
        said, self._said, self._told_at = self._said, array("d"), time.monotonic()
        seconds = np.frombuffer(said).reshape(-1, len(self._nobody))
        return Trips(t + 1 - len(seconds), seconds) if said else None
