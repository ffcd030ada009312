"""The Markdown of the panels: names of nodes, networks and laws are words, not markup."""

import numpy as np

from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.views.event_texts import Now, about
from hedgerow.topologies.schema import Topology
from tests.tools.networks import read, simulate

TEXT = (
    "{name: _my_network_, b: 0.1, steps: 4, nodes: [_a_, __b__, c], edges: [[_a_, __b__], [__b__, c]],"
    " faults: [{kind: cut, edge: [_a_, __b__]}, {kind: drop, from: __b__, to: c}, {kind: sensor, node: _a_}]}"
)


def texts(topology: Topology) -> str:
    observer = Observer(topology)
    batch = observer.take(simulate(topology).rows)
    return "\n".join(Now(topology, observer).texts(batch, np.arange(len(batch.t))))


def test_names_are_no_markup() -> None:
    topology = read(TEXT)
    shown = texts(topology) + about(topology, Observer(topology), large=False, pictures_hz=10)
    assert "_a_" not in shown
    assert "__b__" not in shown
    assert "_my_network_" not in shown
    assert r"\_a\_" in shown
    assert r"# \_my\_network\_" in shown
