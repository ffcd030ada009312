"""The bounds of a network from above and, where `worst` has found one, from below."""

from __future__ import annotations

from dataclasses import replace

from hedgerow.orchestrator.metrics.guarantee import Guarantee, guarantee, plant_of
from hedgerow.topologies.named import Named, resolved


def bound(network: Named, full: bool = False) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law; docs/guarantee.md.

    network: as of `topologies.named.text_of`. full: with a full storage matrix P, which takes longer.
    """
    topology = resolved(network)
    found = topology.network
    return replace(guarantee(plant_of(found), found.gamma_star, full))
