"""What every part of the operator stands on: assignment, signals, the background thread."""
