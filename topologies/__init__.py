"""What a network is: its schema, how a file of it is read, drawn and checked, and the bundled files.

`topologies.load` reads a file, `topologies.schema` says what may stand in one, `topologies.faults` what may go
wrong, `topologies.graph` and `topologies.hinf` are the mathematics. Nothing is imported here: an agent needs
`topologies.errors`, `archive`, `graph`, `fast` (with numba, `kernels`) and `toml` alone, and the plant `effects`,
`network` and `hinf` beside them.
"""
