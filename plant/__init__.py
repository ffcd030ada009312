"""The world: dynamics (1), disturbances, the lockstep clock, and the process that runs them.

`world` and `disturbance` do no I/O; `truth` is the input of the plant; `process` connects the world to Zenoh.
"""
