"""A watch on the plant of an agent; no other process would end an agent that was started by hand."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType

import zenoh

from hedgerow.topologies.errors import HedgerowError
from hedgerow.wire import keys
from hedgerow.wire.session import direct

PLANT_GONE_S = 60.0
"""time that the plant's token may be absent; longer than it takes to plug a cable back in"""
LOOK_S = 2.0
"""time that our plant's token may be absent after joining, while another plant's token is present"""


class PlantWatch:
    """A context manager that watches plants' tokens; it gives up if our plant is gone or another plant replaced it.

    While our plant's token is present, another plant's token is ignored. A second run may have begun by mistake, or the
    token of a dead plant may not have expired yet.
    """

    def __init__(self, session: zenoh.Session, plant: int, give_up: Callable[[HedgerowError], None]) -> None:
        self._session, self._give_up = session, give_up
        self._ours = keys.alive(keys.PLANT, plant)
        self._seen = False
        """True once our plant's token was present"""
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
        """If our plant's token is absent, give up after the permitted time."""
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
