"""Benchmarks: each is a command that measures in pairs and prints ratios."""
