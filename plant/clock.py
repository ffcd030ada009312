"""The clock of the steps: rate, pause and single steps, and the time that an answer takes."""

from __future__ import annotations

import time

RESEND_AFTER_S = 0.5


class Clock:
    """The time of one run; all times are by time.monotonic(), in seconds."""

    def __init__(self, rate: float) -> None:
        self.began = self.sent_at = time.monotonic()
        self.held = False
        """the next state is ready and has not been sent"""
        self.paused = False
        self._allowed = 0
        """the number of steps that are permitted during a pause"""
        self._repeats = 0
        self.set_rate(rate, 0)

    def start(self) -> None:
        """Permit the first state."""
        self.began = time.monotonic()
        self.set_rate(self.rate, 0)

    def set_rate(self, rate: float, t: int) -> None:
        """Set the rate in steps per second from step t on; 0 means as fast as possible."""
        self.rate = rate
        self._period = min(1 / rate, 1e9) if rate else 0.0
        self._base, self._base_t = time.monotonic(), t

    def pause(self) -> None:
        """Hold the next state until `resume`."""
        self.paused, self._allowed = True, 0

    def resume(self, t: int) -> None:
        """Continue at the same rate from step t."""
        self.paused, self._allowed = False, 0
        self.set_rate(self.rate, t)

    def allow(self, steps: int) -> None:
        """Pause after the given number of steps, made at the same rate."""
        self.paused = True
        self._allowed += steps

    def wait_s(self, t: int) -> float:
        """Return how long state(t) must still be held, in seconds; infinite while paused."""
        if self.paused:
            return self.sent_at + self._period - time.monotonic() if self._allowed else float("inf")
        return self._base + (t - self._base_t) * self._period - time.monotonic() if self._period else 0.0

    def sent(self) -> None:
        """Record that state(t) was sent."""
        self.held, self.sent_at, self._repeats = False, time.monotonic(), 0
        if self.paused:
            self._allowed -= 1

    def waited_s(self) -> float:
        """Return the time since the last state was sent [s]."""
        return time.monotonic() - self.sent_at

    def repeat_is_due(self) -> bool:
        """Return True if the last state should be sent again; True once every RESEND_AFTER_S."""
        if self.waited_s() <= RESEND_AFTER_S * (self._repeats + 1):
            return False
        self._repeats += 1
        return True
