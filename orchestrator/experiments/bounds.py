"""The upper bounds of a network and, if `worst` has found one, its lower bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.experiments.worst import at_least
from hedgerow.orchestrator.metrics.gain_bound import Method
from hedgerow.orchestrator.metrics.guarantee import Guarantee, guarantee, plant_of
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.schema import Topology


def bound(network: Named, method: Method | None = None) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law; docs/guarantee.md.

    network: as in `topologies.named.text_of`. method: the program; None chooses one that takes about a second.
    """
    # The text of a large network is a table beside it, which only a file has.
    topology = network if isinstance(network, Topology) else resolved(network)
    found = topology.network
    plant = plant_of(found)
    return replace(guarantee(plant, found.gamma_star, method), at_least=at_least(plant, Path()))
