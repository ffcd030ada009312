"""The operator: it launches a network, observes it, records it, and judges the run.

`import hedgerow` is its interface.
"""
