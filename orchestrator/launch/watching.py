"""The destinations of the Rerun data of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Watching:
    """The destinations of Rerun data: run.rrd or none, and a viewer as named by `views.rerun.viewer.choose`."""

    record: bool = True
    viewer: str = "none"
    split_mb: float = 256.0
    """the size of run.rrd [MB] at which a next file begins; 0 for one file"""
    keep: bool = False
    """leave the page of a finished run open until Ctrl-C"""
