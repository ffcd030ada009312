"""Benchmarks: each a command that measures in pairs and prints ratios."""
