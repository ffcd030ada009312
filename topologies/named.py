"""A network as an argument in Python: a bundled name, a path, a text, a dictionary, or a Topology."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.load import content, find, parse
from hedgerow.topologies.resolve import resolve, to_yaml
from hedgerow.topologies.schema import Topology

Named = str | Path | Mapping[str, Any] | Topology
"""A network as an argument in Python; see `text_of`."""


def text_of(network: Named) -> tuple[bytes, str, Path]:
    """Return the text of a network, its name in messages, and the folder of its CSV files.

    `network` is a bundled name, the path of a file or of a run folder, the text of a file, a dictionary of the same
    shape, or a Topology. Raises UserError if there is no such file, or it cannot be read.
    """
    if isinstance(network, Topology):
        return to_yaml(network).encode(), network.name, Path()
    if isinstance(network, Mapping):
        # A network of hg.Network has a folder if its table or samples lie in files.
        return json.dumps(dict(network)).encode(), "network", getattr(network, "folder", None) or Path()
    if isinstance(network, str) and ("\n" in network or network.lstrip().startswith("{")):
        return network.encode(), "network", Path()
    if not isinstance(network, str | Path):
        raise UserError(
            f"{type(network).__name__}: is no network. Give a name, a path, a text, a dictionary or a Topology.",
            code=Code.TOPOLOGY,
        )
    path = find(str(network))
    return content(path), str(path), path.parent


def resolved(network: Named, overrides: Sequence[str] = ()) -> Topology:
    """Return a network with all numbers drawn; arguments and errors as in `text_of` and `load.load`."""
    text, name, folder = text_of(network)
    # A dictionary is the user's own, and so are the paths in it.
    named = set(_files(network)) if isinstance(network, Mapping) else ()
    return resolve(parse(text, name, folder, overrides, named), folder)


def _files(content: Any) -> Iterator[str]:
    """Return the whole paths that a dictionary gives for samples."""
    if isinstance(content, Mapping):
        if content.get("kind") == "samples" and isinstance(content.get("file"), str):
            yield content["file"]
        for value in content.values():
            yield from _files(value)
    elif isinstance(content, list | tuple):
        for value in content:
            yield from _files(value)
