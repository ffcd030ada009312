"""Experiments with many runs: sweeps, comparisons, random faults, long runs."""
