"""A network with its numbers in a table, as a value in Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.orchestrator.deploy.containers import containers
from hedgerow.orchestrator.experiments.worst import worst
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.nodes import SPELLED_OUT
from hedgerow.topologies.resolve import digest, save, to_yaml

LARGE: dict[str, Any] = {
    "name": "large",
    "b": 0.05,
    "steps": 3,
    "seed": 1,
    "graph": {"kind": "ring", "nodes": SPELLED_OUT + 1},
    "defaults": {"candidates": [0.2, 0.5, 0.8], "x0": {"random": [-1, 1]}},
}


def test_it_runs_with_the_numbers_that_it_shows(here: Path) -> None:
    network = hg.load(LARGE)
    assert hg.simulate(network) == hg.simulate(LARGE)
    shorter = hg.simulate(network, steps=2)
    assert shorter.T == 2
    assert (shorter.x == hg.simulate(network).x[:3]).all()


@pytest.mark.slow
def test_it_runs_over_zenoh(here: Path) -> None:
    network = hg.load(LARGE)
    assert hg.run(network, processes=2) == hg.simulate(network)


def test_no_text_alone_holds_it(tmp_path: Path) -> None:
    network = hg.load(LARGE)
    with pytest.raises(UserError) as refused:
        to_yaml(network)
    assert refused.value.code == Code.TOPOLOGY
    save(network, tmp_path / "network.yaml")
    again = hg.load(tmp_path / "network.yaml")
    assert digest(again) == digest(network)
    assert (again.network.x0 == network.network.x0).all()


def test_another_number_in_the_table_is_another_network() -> None:
    """A sweep continues only with the same networks."""
    one, other = hg.load(LARGE), hg.load(LARGE | {"seed": 2})
    same_text = other.model_copy(update={"seed": 1})
    assert not np.array_equal(one.network.x0, same_text.network.x0)
    assert digest(one) != digest(same_text)


def test_no_container_is_given_a_file_that_it_cannot_read() -> None:
    network = hg.load(LARGE)
    with pytest.raises(UserError) as refused:
        containers(network, layout(network, 2), "hedgerow/large", 0.0, 10**9)
    assert refused.value.code == Code.TOPOLOGY


def test_the_worst_disturbance_is_sought_too(here: Path) -> None:
    found = worst(hg.load(LARGE), 0.1, steps=100, out=Path("worst.yaml"))
    assert hg.simulate("worst.yaml").gain[-1] == pytest.approx(found.gain, rel=1e-9)


@pytest.mark.slow
def test_a_fault_of_the_running_network_is_in_its_file(here: Path) -> None:
    with hg.start(hg.load(LARGE, steps=100_000), processes=2) as live:
        live.fault.drop((1, 2), steps=range(5))
        live.wait_for_step(30)
        folder = live.folder
    run = hg.load_run(folder)
    assert [one.kind for one in run.topology.faults] == ["drop"]
    assert run.verdict.verdict != "INVALID"
