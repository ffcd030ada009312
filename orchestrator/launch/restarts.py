"""The restart rule for agents that die by themselves, both forked ones and those on Ray."""

from __future__ import annotations

from dataclasses import dataclass

RESTARTS = 5
"""The maximum number of restarts of an agent that died by itself; then it stays down."""
BACKOFF_S = 0.1
"""The wait before the first restart; each next restart of the same kind waits twice as long."""
MOST_BACKOFF_S = 5.0
"""The longest wait before a restart."""
UNREACHED_S = 300.0
"""The time for which an agent that does not reach the router is restarted; then it stays down.

A router that is busy with 1000 bare connections accepts no agent for 103 s (docs/security.md).
"""


@dataclass
class Restarts:
    """The unplanned deaths of one agent, over all its lives.

    A life that never reached the router does not count as a restart. Otherwise, an outsider could
    end an agent for good by keeping the router busy.
    """

    deaths: int = 0
    """the number of deaths after reaching the router"""
    unreached: int = 0
    """the number of deaths in a row before reaching the router"""
    since: float = 0.0
    """the time of the first of these, by time.monotonic()"""
    total: int = 0
    """the number of all deaths"""

    def after_death(self, reached: bool, now: float) -> float | None:
        """Count an unplanned death; return the wait before the next life [s], None if there is none."""
        self.total += 1
        if reached:
            again, before = self.deaths < RESTARTS, self.deaths
            self.deaths, self.unreached = self.deaths + 1, 0
        else:
            if not self.unreached:
                self.since = now
            again, before = now - self.since < UNREACHED_S, self.unreached
            self.unreached += 1
        return min(BACKOFF_S * 2 ** min(before, 16), MOST_BACKOFF_S) if again else None

    @property
    def failed(self) -> bool:
        """Return True if it died more than RESTARTS times, in any way."""
        return self.total > RESTARTS
