"""The answer times of the shards, from state(t) to input(t), by the plant's clock.

The clock of another machine has no influence. An answer waits for the neighbours' messages of t - 1 too, so that a slow
link between two agents shows at both. A repeated message counts from its first time.
"""

from __future__ import annotations

import time
from array import array

import numpy as np

from hedgerow.wire.message import RoundTripTimes

SEND_EVERY_S = 0.5


class Stopwatch:
    """The answer times of every step; a step costs little more than one clock reading per shard."""

    def __init__(self, shards: int) -> None:
        self._no_answers = array("d", [float("nan")] * shards)
        self.now = self._no_answers[:]
        """the answer times of this step [s], NaN for shards without an answer"""
        self._unsent = array("d")
        """the answer times since the last message to the observer"""
        self._sent_at = time.monotonic()

    def end_step(self) -> bool:
        """End the step; return True if it is time to send the answer times to the observer."""
        self._unsent += self.now
        self.now = self._no_answers[:]
        return time.monotonic() - self._sent_at > SEND_EVERY_S

    def take_out(self, t: int) -> RoundTripTimes | None:
        """Return the answer times since the last call, the last of them of step t; None if there were no steps."""
        unsent, self._unsent, self._sent_at = self._unsent, array("d"), time.monotonic()
        seconds = np.frombuffer(unsent).reshape(-1, len(self._no_answers))
        return RoundTripTimes(t + 1 - len(seconds), seconds) if unsent else None
