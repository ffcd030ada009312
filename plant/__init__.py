"""The world: dynamics (1), disturbances, the lockstep clock, and the process around them.

`world` and `disturbance` are pure; `truth` is what the plant is told; `process` puts the world on the wire.
"""
