"""The control law of an agent, and the process that runs it.

`law` is the paper's law, equations (6) and (7). `shard` feeds it from the messages of its nodes. `view` is the part of
the network that a process knows. `process` connects a shard to Zenoh.
"""
