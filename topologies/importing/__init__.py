"""Networks of other tools: readers for their files and objects, and the topology made from them.

`files` finds the reader of a file, and `objects` reads graphs, matrices and data frames of Python. A reader returns a
`found.Found`; `simple` makes an undirected graph with ids from it, and `written` the topology. Each reader loads its
library at its first use.
"""
