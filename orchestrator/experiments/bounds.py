"""The bounds of a network from above and, where `worst` has found one, from below."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.experiments.worst import at_least, guarantee_of
from hedgerow.orchestrator.metrics.gain_bound import Method
from hedgerow.orchestrator.metrics.guarantee import Guarantee, plant_of
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.schema import Topology


def bound(network: Named, method: Method | None = None) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law; docs/guarantee.md.

    network: as of `topologies.named.text_of`. method: the program; None chooses one that takes about a second.
    """
    # The text of a large network is a table beside it, which only a file has.
    topology = network if isinstance(network, Topology) else resolved(network)
    found, reached, attack = at_least(plant_of(topology.network), Path()) or (None, None, "")
    return replace(guarantee_of(topology, method), at_least=found, reached=reached, attack=attack)
