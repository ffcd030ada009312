"""The base of the operator: assignment, signals, the background thread."""
