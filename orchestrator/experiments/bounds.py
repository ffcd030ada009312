"""The upper bounds of a network and, if `worst` has found one, its lower bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hedgerow.orchestrator.experiments.worst import at_least
from hedgerow.orchestrator.metrics.guarantee import Guarantee, guarantee, plant_of
from hedgerow.topologies.named import Named, resolved


def bound(network: Named, full: bool = False) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law; docs/guarantee.md.

    network: as in `topologies.named.text_of`. full: with a full storage matrix P, which takes longer.
    """
    topology = resolved(network)
    found = topology.network
    plant = plant_of(found)
    return replace(guarantee(plant, found.gamma_star, full), at_least=at_least(plant, Path()))
