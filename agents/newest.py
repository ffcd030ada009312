"""The newest values of neighbours that have arrived over each incidence, for a law that acts on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hedgerow.agents.local import Received
from hedgerow.agents.samples import LateRows, Samples
from hedgerow.agents.view import View
from hedgerow.topologies.graph import Array, Mask
from hedgerow.wire.message import Flag


class Newest:
    """The newest state and input of the neighbour of each incidence, with their step; NaN and -1 if none arrived."""

    def __init__(self, view: View, samples: Samples) -> None:
        self._column, self._samples, self._k = view.column, samples, view.k
        m = len(view.row)
        self._values = Received(
            -1, np.ones(view.k, dtype=bool), np.full(m, np.nan), np.full(m, np.nan), np.full(m, -1, dtype=np.int64)
        )

    def at(self, t: int) -> Received:
        """Return a copy for `act` at step t."""
        return self._values.at(t)

    def forget(self, lost: Mask) -> None:
        """Forget the values of some incidences, (m,): a new process has received nothing from its neighbours yet."""
        now = self._values
        self._values = now._replace(
            x=np.where(lost, np.nan, now.x),
            u=np.where(lost, np.nan, now.u),
            step=np.where(lost, -1, now.step),
        )

    def note(self, past: int, states: Array, inputs: Array, used: bytes, late_rows: Sequence[LateRows]) -> None:
        """Keep the values of step `past` and of late rows, where they are newer than those kept.

        `states` and `inputs` are our own and then the peers'; `used` are the Flag bits of the inputs used, (m,). Call
        it before the sample of `past` is taken: rows of our own nodes are as far back as those in a message.
        """
        column, now = self._column, self._values
        got = np.isfinite(states[column] + inputs[column])  # a neighbour without a reading has no input either
        got &= np.frombuffer(used, np.uint8) & Flag.RECEIVE != 0
        x, u = np.where(got, states[column], now.x), np.where(got, inputs[column], now.u)
        step = np.where(got, past, now.step)
        for c, start, stop, inputs_then, states_then in late_rows:
            if stop - 1 <= step[c]:
                continue
            if inputs_then is not None and states_then is not None:
                rows = states_then, inputs_then
            elif (place := column[c]) < self._k:
                own_x, own_u = self._samples.sent(start, stop)
                rows = own_x[:, place], own_u[:, place]
            else:
                continue
            known = np.flatnonzero(np.isfinite(rows[0] + rows[1]))
            if len(known) and (newest := stop - len(rows[0]) + int(known[-1])) > step[c]:
                x[c], u[c], step[c] = rows[0][known[-1]], rows[1][known[-1]], newest
        self._values = now._replace(x=x, u=u, step=step)
