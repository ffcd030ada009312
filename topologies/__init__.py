"""What a network is: its schema, how a file of it is read, drawn and checked, and the bundled files.

`hedgerow.topologies.load` reads a file, `hedgerow.topologies.schema` says what may stand in one, `hedgerow.topologies.faults` what may go
wrong, `hedgerow.topologies.graph` and `hedgerow.topologies.hinf` are the mathematics. Nothing is imported here: an agent needs
`hedgerow.topologies.errors`, `archive`, `graph`, `fast` (with numba, `kernels`) and `toml` alone, and the plant `effects`,
`network` and `hinf` beside them.
"""
