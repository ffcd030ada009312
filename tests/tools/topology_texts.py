"""Small texts of topology files, and the mistakes in them."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Problem, TopologyError
from hedgerow.topologies.load import parse
from hedgerow.topologies.schema import Topology

GOOD = """\
name: pair
b: 0.1
steps: 3
seed: 4
defaults: {x0: 1, candidates: [0.3, 0.6]}
nodes:
  1: {}
  2: {a: 0.6}
edges:
  - [1, 2]
"""
HEAD = "name: n\nb: 0.1\nsteps: 3\n"


def problems(text: str | bytes, *overrides: str, folder: Path = Path()) -> list[Problem]:
    """Return the mistakes of a file with this text."""
    text = text.encode() if isinstance(text, str) else text
    with pytest.raises(TopologyError) as caught:
        parse(text, "bad.yaml", folder, overrides)
    return list(caught.value.problems)


def only(text: str | bytes, *overrides: str, folder: Path = Path()) -> Problem:
    """Return the only mistake of a file."""
    (problem,) = problems(text, *overrides, folder=folder)
    return problem


def good(text: str, *overrides: str, folder: Path = Path()) -> Topology:
    return parse(text.encode(), "good.yaml", folder, overrides)
