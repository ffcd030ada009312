"""A network as an argument in Python: a bundled name, a path, a text, a dictionary, or a Topology."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hedgerow.topologies.errors import Code, TopologyError, UserError
from hedgerow.topologies.load import content, find, parse
from hedgerow.topologies.nodes import Nodes
from hedgerow.topologies.plain import plain
from hedgerow.topologies.resolve import resolve, text_beside_table
from hedgerow.topologies.schema import Topology
from hedgerow.topologies.table import Table

MAPPING = "the network"
"""The name of a dictionary in messages. Its text is ours, so that a line and a column would mean nothing."""
Named = str | Path | Mapping[str, Any] | Topology
"""A network as an argument in Python; see `text_of`."""


class Given(NamedTuple):
    """A network as it was given, before its numbers are drawn."""

    text: bytes
    name: str
    """the name in messages"""
    folder: Path
    """the folder of its CSV files"""
    overrides: tuple[str, ...] = ()
    """`path=value` settings"""
    own_files: tuple[str, ...] = ()
    """files of samples that the user named in Python, and which may be anywhere"""
    table: Table | None = None
    """the numbers of a large Topology, which no text holds"""

    def __repr__(self) -> str:
        return f"<{' '.join([self.name, *self.overrides])}>"

    def with_overrides(self, *overrides: str) -> Given:
        """Return the same network with further settings."""
        return self._replace(overrides=(*self.overrides, *overrides))

    def parse(self) -> Topology:
        """Return the network with no number drawn yet; raise TopologyError with every mistake."""
        try:
            return parse(self.text, self.name, self.folder, self.overrides, self.own_files, self.table)
        except TopologyError as error:
            if self.name == MAPPING:
                error.without_lines()
            raise

    def draw(self) -> Topology:
        """Return the network with all numbers drawn, which remembers this text."""
        return resolve(self.parse(), self.folder).with_given(self)


def given(network: Named) -> Given:
    """Return a network as it was given, for other seeds: a Topology of `hg.load` is drawn again from its file.

    A changed copy of a Topology, and one of a run folder, have the numbers that they show, for every seed. So does one
    with a setting of a drawn value, which has no place in the file.
    """
    remembered = _remembered(network)
    if remembered is not None:
        with contextlib.suppress(UserError):
            remembered.parse()
            return remembered
    return _given(network)


def _remembered(network: Named) -> Given | None:
    """Return the text that a Topology was drawn from, with its settings, which may not fit the text."""
    return network.given_as if isinstance(network, Topology) and isinstance(network.given_as, Given) else None


def text_of(network: Named) -> tuple[bytes, str, Path]:
    """Return the text of a network, its name in messages, and the folder of its CSV files.

    `network` is a bundled name, the path of a file or of a run folder, the text of a file, a dictionary of the same
    shape, or a Topology. Raises UserError if there is no such file, or it cannot be read.
    """
    if isinstance(network, Topology):
        return text_beside_table(network).encode(), network.name, Path()
    if isinstance(network, Mapping):
        # A network of hg.Network has a folder if its table or samples lie in files.
        return json.dumps(plain(network)).encode(), MAPPING, getattr(network, "folder", None) or Path()
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
    drawn = _given(network).with_overrides(*overrides).draw()
    remembered = _remembered(network)
    return drawn if remembered is None else drawn.with_given(remembered.with_overrides(*overrides))


def _given(network: Named) -> Given:
    # Make the text first: it refuses a dictionary that contains itself.
    text, name, folder = text_of(network)
    if isinstance(network, Topology) and isinstance(network.nodes, Nodes):
        return Given(text, name, folder, table=Table.of(network.network, network.layout))
    return Given(text, name, folder, own_files=tuple(_files(network)) if isinstance(network, Mapping) else ())


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
