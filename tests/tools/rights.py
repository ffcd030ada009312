"""The places of a secure paper7, their rights, and the keys of all its messages."""

from __future__ import annotations

import itertools
from pathlib import Path

from hedgerow.orchestrator.ground.assignment import layout, places, views_of
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire import keys
from hedgerow.wire.access import rights

N = 7
PAPER7 = resolve(load("paper7"), Path())
PLACES = places(views_of(PAPER7, layout(PAPER7, None)))
RIGHTS = rights(PLACES)
KEYS = [
    *(keys.state(p) for p in range(N)),
    *(keys.input_(p) for p in range(N)),
    *(keys.link(p, q) for p, q in itertools.permutations(range(N), 2)),
    keys.TELEMETRY,
    keys.SEEN,
]
WILD = ["**", "link/**", "link/*/1", "state/*"]
