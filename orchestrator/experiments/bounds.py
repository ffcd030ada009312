"""The bounds of a network from above and, where `worst` has found one, from below."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.experiments.worst import at_least
from hedgerow.orchestrator.metrics.gain_bound import Method
from hedgerow.orchestrator.metrics.gain_learning import Learning, learning
from hedgerow.orchestrator.metrics.guarantee import Guarantee, guarantee, plant_of
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.schema import Topology


def bound(network: Named, method: Method | None = None) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law; docs/guarantee.md.

    network: as of `topologies.named.text_of`. method: the program; None chooses one that takes about a second.
    """
    # The text of a large network is a table beside it, which only a file has.
    topology = network if isinstance(network, Topology) else resolved(network)
    found = topology.network
    plant = plant_of(found)
    counted: Learning | str
    try:
        counted = learning(plant, found.candidates)
    except HedgerowError as error:
        counted = str(error)
    bounds = guarantee(plant, found.gamma_star, method)
    return replace(bounds, at_least=at_least(plant, Path()), learning=counted)
