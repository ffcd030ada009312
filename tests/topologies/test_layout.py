"""The resolved file records the process of each node if a fault depends on it: a run repeats on every machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.fault_changes import with_loss
from hedgerow.topologies import partition, resolve
from hedgerow.topologies.errors import Code, TopologyError
from hedgerow.topologies.faults import effects
from hedgerow.topologies.load import load
from tests.tools.networks import read, simulate

NODES = 200
HEAD = (
    "{name: n, b: 0.1, steps: 6, seed: 3, processes: 3,"
    f" graph: {{kind: random_regular, nodes: {NODES}}}, defaults: {{x0: {{random: [1, 9]}}}}"
)
KILLED = f"{HEAD}, faults: [{{kind: crash, process: 1, at: 2, restart_after: 2}}]}}"


def without_metis(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partition, "_by_metis", lambda *_: [])


@pytest.mark.parametrize("spelled_out", [1000, 6], ids=["in the file", "in its table"])
def test_a_fault_of_a_process_strikes_the_same_nodes_on_a_machine_without_metis(
    spelled_out: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pymetis")
    monkeypatch.setattr(resolve, "SPELLED_OUT", spelled_out)
    topology = read(KILLED)
    resolve.save(topology, tmp_path / "topology.yaml")
    ran = simulate(topology, layout(topology, 3))
    without_metis(monkeypatch)
    again = resolve.resolve(load(str(tmp_path)))
    assert [part.tolist() for part in again.parts] == [part.tolist() for part in topology.parts]
    assert effects(again.faults, again)[0].targets == effects(topology.faults, topology)[0].targets
    assert simulate(again, layout(again, 3)).same_bits(ran)
    assert simulate(again, layout(again, 5)).same_bits(ran)
    other = read(KILLED)
    assert effects(other.faults, other)[0].targets != effects(topology.faults, topology)[0].targets


def test_the_layout_stands_in_a_file_only_if_a_fault_depends_on_it() -> None:
    quiet = read(f"{HEAD}}}")
    assert quiet.layout is None
    assert read(KILLED.replace(f"nodes: {NODES}", "nodes: 12")).layout is None
    lost = with_loss(quiet, 1, [], 2)
    assert lost.layout is not None
    assert np.bincount(lost.layout).tolist() == [len(part) for part in quiet.parts]


SMALL = "{{name: n, b: 0.1, steps: 2, processes: 2, nodes: [1, 2, 3], edges: [[1, 2]], layout: {}}}"


def test_a_layout_of_ones_own_is_followed() -> None:
    topology = read(SMALL.format("[1, 0, 1]"))
    assert [list(part) for part in layout(topology, 2)] == [[1], [0, 2]]
    assert [len(part) for part in layout(topology, 3)] == [1, 1, 1]


@pytest.mark.parametrize("listed", ["[0, 1]", "[0, 1, 2]", "[0, 0, 0]", "[0, 1, -1]", "[0, 1, x]"])
def test_a_layout_that_is_none_is_refused(listed: str) -> None:
    with pytest.raises(TopologyError) as raised:
        read(SMALL.format(listed))
    assert {problem.code for problem in raised.value.problems} <= {Code.TOPOLOGY, Code.FILE_FORMAT}
