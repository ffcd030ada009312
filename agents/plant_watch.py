"""Whether the plant that an agent joined is still there: who was started by hand has nobody else to end it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType

import zenoh

from hedgerow.topologies.errors import HedgerowError
from hedgerow.wire import keys
from hedgerow.wire.session import direct

PLANT_GONE_S = 60.0
"""How long the plant may be out of sight; a cable that was pulled is put back sooner."""
LOOK_S = 2.0
"""How long the plant that has just given us our place may not be seen, where another is."""


class PlantWatch:
    """Watches plants' tokens while a block lasts, and gives up when ours is gone for good, or another's in its place.

    While ours is there another's means nothing: somebody began a second run by mistake, or the token of one that died
    is not forgotten yet.
    """

    def __init__(self, session: zenoh.Session, plant: int, give_up: Callable[[HedgerowError], None]) -> None:
        self._session, self._give_up = session, give_up
        self._ours = keys.alive(keys.PLANT, plant)
        self._seen = False
        """whether ours was ever there"""
        self._there: set[str] = set()
        self._patience: threading.Timer | None = None

    def __enter__(self) -> None:
        self._look()
        plants = keys.alive(keys.PLANT, "*")
        self._tokens = self._session.liveliness().declare_subscriber(plants, direct(self._take), history=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._wait_no_longer()

    def _take(self, sample: zenoh.Sample) -> None:
        plant = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self._there.add(plant)
        else:
            self._there.discard(plant)
        self._seen = self._seen or plant == self._ours
        self._look()

    def _look(self) -> None:
        """Give up where ours is not to be seen, after as long as it may yet be."""
        self._wait_no_longer()
        if self._ours in self._there:
            return
        if self._there:
            why, patience_s = "another run has begun here, and we are of the one before", 0.0 if self._seen else LOOK_S
        else:
            why, patience_s = f"the plant is gone: not seen for {PLANT_GONE_S:g} s", PLANT_GONE_S
        error = HedgerowError(f"{why}; start us again with the next run")
        self._patience = threading.Timer(patience_s, self._give_up, [error])
        self._patience.daemon = True
        self._patience.start()

    def _wait_no_longer(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
