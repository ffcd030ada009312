"""Networks in tests: what the fixture `network` gives, runs, and leaves (docs/testing.md)."""

from orchestrator.testing.result import Estimates, Result
from orchestrator.testing.running import Running
from orchestrator.testing.scenario import Networks, Scenario

__all__ = ["Estimates", "Networks", "Result", "Running", "Scenario"]
