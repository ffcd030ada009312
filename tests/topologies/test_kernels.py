"""A large network gives the same bits as a small one: compiled loops, and queued rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hedgerow.agents.law import Minimax
from hedgerow.orchestrator.metrics.observer import Batch
from hedgerow.topologies import fast
from hedgerow.topologies.graph import Array
from hedgerow.topologies.schema import Topology
from hedgerow.wire import history
from tests.test_faults import faulty
from tests.tools.networks import networks, observe, partitions, simulate


@contextmanager
def everything_is_large() -> Iterator[None]:
    """As if one node were a large network."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fast, "LARGE", 1)
        patch.setattr(history, "LONG", 1)
        yield


def test_the_compiled_loops_are_to_be_had() -> None:
    """Without numba the tests below would compare numpy with itself."""
    pytest.importorskip("numba")
    assert fast.kernels_for(fast.LARGE) is not None
    assert fast.kernels_for(fast.LARGE - 1) is None


def test_a_long_run_of_a_small_network_loads_the_compiled_loops() -> None:
    pytest.importorskip("numba")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fast, "_in_long_runs", False)
        fast.prepare(nodes=100, steps=30)
        assert fast.kernels_for(100) is None
        fast.prepare(nodes=100, steps=fast.WORTH)
        fast.prepare(nodes=100, steps=30)
        assert fast.kernels_for(100) is not None
        assert fast.unequal_kernels_for(100) is not None


@given(topology=faulty(), past=st.sampled_from([1, 2, 5, 100_000]), data=st.data())
def test_a_large_network_runs_as_a_small_one_does(topology: Topology, past: int, data: st.DataObject) -> None:
    topology = topology.model_copy(update={"history": past})
    shards = data.draw(partitions(len(topology.ids)))
    small = simulate(topology, shards)
    with everything_is_large():
        assert simulate(topology, shards).same_bits(small)


@given(networks())
def test_a_large_network_is_observed_as_a_small_one_is(topology: Topology) -> None:
    ran = simulate(topology)
    observer, batch = observe(topology, ran)
    with everything_is_large():
        other, same = observe(topology, ran)
    assert summary_of(batch) == summary_of(same)
    assert repr(observer.summary()) == repr(other.summary())


def summary_of(batch: Batch) -> dict[str, bytes]:
    """Every column of a batch, as bytes."""
    return {name: getattr(batch, name).tobytes() for name in batch.__dataclass_fields__}


@given(
    nodes=st.sampled_from([1, 255, 256, 257, 600]),
    models=st.integers(1, 4),
    unequal=st.booleans(),
    digits=st.integers(0, 3),
    seed=st.integers(0, 2**16),
)
def test_blocks_of_nodes_learn_as_numpy_does(nodes: int, models: int, unequal: bool, digits: int, seed: int) -> None:
    """With few digits, many candidates are equally good; some nodes have fewer candidates."""
    pytest.importorskip("numba")
    numbers = np.random.default_rng(seed)

    def draw(*shape: int) -> Array:
        return numbers.uniform(0.1, 0.9, shape).round(digits)

    candidates = draw(models, nodes)
    candidates[1:][draw(models - 1, nodes) < 0.3] = np.nan
    b = draw(nodes) if unequal else 0.1
    samples = [(draw(nodes), draw(nodes), draw(nodes)) for _ in range(3)]

    def learned() -> bytes:
        law = Minimax(b, candidates)
        for sample in samples:
            law.learn(*sample)
        return bytes(law.memory.tobytes() + law.report().tobytes())

    expected = learned()
    with everything_is_large():
        assert learned() == expected
