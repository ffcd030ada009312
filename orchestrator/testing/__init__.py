"""Networks in tests: what the fixture `network` gives, runs, and leaves (docs/testing.md)."""

from hedgerow.orchestrator.testing.result import Estimates, Result
from hedgerow.orchestrator.testing.running import Running
from hedgerow.orchestrator.testing.scenario import Networks, Scenario

__all__ = ["Estimates", "Networks", "Result", "Running", "Scenario"]
