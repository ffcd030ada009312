"""When a step may begin."""

from __future__ import annotations

from hedgerow.plant.clock import Clock


def test_pending_single_steps_are_dropped_on_resume() -> None:
    clock = Clock(0.0)
    clock.allow(10)
    clock.sent()
    clock.resume(1)
    clock.allow(1)
    assert clock.wait_s(1) <= 0
    clock.sent()
    assert clock.wait_s(2) == float("inf")


def test_single_steps_keep_the_rate() -> None:
    """The same holds for the first: its distance from the last step is the same."""
    period_s = 1000.0
    clock = Clock(1 / period_s)
    clock.sent()
    clock.pause()
    clock.allow(2)
    for t in (1, 2):
        assert period_s / 2 < clock.wait_s(t) <= period_s
        clock.sent()
    assert clock.wait_s(3) == float("inf")
    clock.set_rate(0.0, 3)
    clock.allow(1)
    assert clock.wait_s(3) <= 0
