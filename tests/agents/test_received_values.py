"""The values of neighbours that a law gets: a step of 0 or more means that both values are numbers."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hedgerow.agents.law import Array, Minimax
from hedgerow.agents.local import Local, Received
from hedgerow.orchestrator.ground import laws
from hedgerow.topologies.schema import Topology
from tests.test_faults import faulty
from tests.tools.networks import partitions, read, simulate


class Checks(Minimax):
    """Acts on and learns from every value with a step, so a value that is no number would reach its input."""

    def __init__(self, b: float, candidates: Array, *, local: Local) -> None:
        super().__init__(b, candidates)
        self.local = local
        self.sums = np.zeros((1, candidates.shape[1]))

    @property
    def memory(self) -> Array:
        return np.vstack([self.J, self.sums])

    @memory.setter
    def memory(self, memory: Array) -> None:
        self.J, self.sums = memory[:-1].copy(), memory[-1:].copy()
        self._choose()

    def _seen(self, received: Received) -> Array:
        there = received.step >= 0
        assert (there == np.isfinite(received.x)).all()
        assert (there == np.isfinite(received.u)).all()
        return self.local.sums(np.tanh(np.where(there, received.x + received.u, 0.0)))

    def act(self, x: Array, now: Received) -> Array:  # type: ignore[override]  # it asks
        assert (now.step < now.t).all()
        return np.asarray(super().act(x) + 1e-3 * (self._seen(now) + self.sums[0]))

    def learn(  # type: ignore[override]  # it asks
        self, x: Array, flow: Array, x_next: Array, sample: Received
    ) -> None:
        assert ((sample.step == sample.t) | (sample.step == -1)).all()
        self.sums = np.where(np.isfinite(flow), 0.9 * self.sums + self._seen(sample), self.sums)
        super().learn(x, flow, x_next)


CHECKS = f"{__name__}:Checks"


def test_a_neighbour_without_a_reading_has_no_values_of_that_step() -> None:
    topology = laws.checked(
        read(
            "{name: pair, b: 0.1, steps: 9, nodes: [1, 2, 3], edges: [[1, 2], [2, 3]], defaults: {x0: 3},"
            " faults: [{kind: sensor, node: 2, steps: [3, 5]}]}"
        ).model_copy(update={"law": CHECKS})
    )
    assert np.isfinite(simulate(topology).x).all()


@given(topology=faulty(), kept=st.sampled_from([1, 3, 100_000]), data=st.data())
@settings(max_examples=25, deadline=None)
def test_a_value_with_a_step_is_a_number_in_every_layout(topology: Topology, kept: int, data: st.DataObject) -> None:
    topology = laws.checked(topology.model_copy(update={"law": CHECKS, "history": kept}))
    assert simulate(topology, data.draw(partitions(len(topology.ids)))).same_bits(simulate(topology))
