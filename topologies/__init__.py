"""What a network is: its schema, how a file of it is read, drawn and checked, and the bundled files.

`topologies.load` reads a file, `topologies.schema` says what may stand in one, `topologies.faults` what may go
wrong, `topologies.graph` and `topologies.hinf` are the mathematics. Nothing is imported here: an agent needs
`topologies.errors` and `topologies.archive` alone, and the plant `topologies.effects` and `topologies.network`
beside them.
"""
