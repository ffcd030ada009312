"""The settings that determine how a file of samples is read."""

from __future__ import annotations

from typing import Literal, NamedTuple

from hedgerow.topologies.header import Header


class Times(NamedTuple):
    """The column of times of a file of samples, and the rule from rows to steps."""

    column: str
    step: float | None = None
    """the time of one step; the first difference if it is None"""
    resample: Literal["hold", "linear", "mean"] | None = None


class Reading(NamedTuple):
    """A file of samples, and the keys that a topology gives for it; docs/topology.md lists them."""

    file: str
    header: Header | None = None
    times: Times | None = None
