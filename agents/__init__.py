"""One agent's mind, and the process around it.

`law` is the paper's law, equations (6) and (7); `shard` feeds it from the messages of its nodes; `view` is
all that a process is told of the network; `process` puts a shard on the wire.
"""
