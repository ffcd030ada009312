"""A network as Python code names it: a bundled name, a path, a text, a dictionary, or a Topology."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hedgerow.topologies.load import content, find, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology

Named = str | Path | Mapping[str, Any] | Topology
"""A network as Python code names it: see `text_of`."""


def text_of(network: Named) -> tuple[bytes, str, Path]:
    """Return the text of a network, its name in messages, and the folder of its CSV files.

    `network` is a bundled name, the path of a file or of a run folder, the text of a file, a dictionary of the same
    shape, or a Topology. Raises UserError if there is no such file, or it cannot be read.
    """
    if isinstance(network, Topology):
        return to_yaml(network).encode(), network.name, Path()
    if isinstance(network, Mapping):
        return json.dumps(network).encode(), "network", Path()
    if isinstance(network, str) and ("\n" in network or network.lstrip().startswith("{")):
        return network.encode(), "network", Path()
    path = find(str(network))
    return content(path), str(path), path.parent


def resolved(network: Named, overrides: Sequence[str] = ()) -> Topology:
    """Return a network with all numbers drawn; arguments and errors are those of `text_of` and `load.load`."""
    text, name, folder = text_of(network)
    return resolve(parse(text, name, folder, overrides), folder)
