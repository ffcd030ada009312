"""The description of a network: its schema; reading, drawing and checking of its file; and the bundled files.

`topologies.load` reads a file, `topologies.schema` has the models, and `topologies.faults` has the kinds of faults.
`topologies.graph` and `topologies.hinf` have the mathematics. Nothing is imported here. An agent needs
`topologies.errors`, `archive`, `graph`, `fast` (with numba, `kernels`) and `toml` alone, and the plant needs `effects`,
`network` and `hinf` in addition.
"""
