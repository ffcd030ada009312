"""The rate limits of the plant for outside requests: commands, requests to join, and liveliness tokens."""

from __future__ import annotations

import time

COMMANDS_PER_S, COMMANDS_AT_ONCE = 1000.0, 4000.0
"""The commands of one kind that the plant answers. Each reads JSON on the thread that also receives inputs."""
BYTES_PER_COMMAND = 4096
"""A longer request counts as several commands, one for each of these lengths."""
JOINS_PER_S, JOINS_AT_ONCE = 10.0, 40.0
"""Requests for one place; an agent asks twice per second."""
TOKENS_PER_S, TOKENS_AT_ONCE = 10.0, 40.0
"""Tokens of one shard; each restart that fails adds a fault to the run.

`up` waits at least 0.1 s between two restarts.
"""


class Allowance:
    """A token bucket: `per_s` units per second, and at most `at_once` saved units.

    Threads that take units at the same moment may receive one unit too many.
    """

    def __init__(self, per_s: float, at_once: float) -> None:
        self._per_s, self._at_once = per_s, at_once
        self._left, self._since = at_once, time.monotonic()

    def take(self, units: float = 1.0, now: float | None = None) -> bool:
        """Take the units if there are enough; return True if so. `now` is a time.monotonic()."""
        now = time.monotonic() if now is None else now
        self._left = min(self._at_once, self._left + self._per_s * max(0.0, now - self._since))
        self._since = max(now, self._since)
        if units > self._left:
            return False
        self._left -= units
        return True
