"""The rate at which outsiders may occupy the plant: with commands, requests to join, and liveliness tokens."""

from __future__ import annotations

import time

COMMANDS_PER_S, COMMANDS_AT_ONCE = 1000.0, 4000.0
"""Commands of one kind that the plant answers: each reads JSON on the thread that also takes inputs."""
BYTES_PER_COMMAND = 4096
"""A longer request counts as so many more."""
JOINS_PER_S, JOINS_AT_ONCE = 10.0, 40.0
"""Requests for one place; an agent asks twice in a second."""
TOKENS_PER_S, TOKENS_AT_ONCE = 10.0, 40.0
"""Tokens of one shard; each new life that dies adds a fault to the run. `up` waits 0.1 s at least between two."""


class Allowance:
    """A token bucket: `per_s` units a second, and at most `at_once` that were saved up.

    Threads that take at the same moment may be granted a unit too many.
    """

    def __init__(self, per_s: float, at_once: float) -> None:
        self._per_s, self._at_once = per_s, at_once
        self._left, self._since = at_once, time.monotonic()

    def take(self, units: float = 1.0, now: float | None = None) -> bool:
        """Take so many units if they are there; return True if they were. `now` is a time.monotonic()."""
        now = time.monotonic() if now is None else now
        self._left = min(self._at_once, self._left + self._per_s * max(0.0, now - self._since))
        self._since = max(now, self._since)
        if units > self._left:
            return False
        self._left -= units
        return True
