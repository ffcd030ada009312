"""From telemetry to metrics, checks and the verdict."""
