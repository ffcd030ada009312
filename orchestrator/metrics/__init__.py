"""The metrics, the checks and the verdict, computed from telemetry."""
