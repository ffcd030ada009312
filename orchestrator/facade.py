"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from hedgerow.orchestrator.experiments import bounds
from hedgerow.orchestrator.experiments.worst import Found
from hedgerow.orchestrator.experiments.worst import worst as search
from hedgerow.orchestrator.ground.laws import checked
from hedgerow.orchestrator.launch import simulation
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.runs.reader import RecordedRun, load_run
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.schema import Topology

__all__ = ["bound", "load", "load_run", "simulate", "worst"]


def load(network: Named, **overrides: object) -> Topology:
    """Return a network with all numbers drawn.

    `network` is a bundled name, the path of a file or run folder, the YAML text of a file, a dictionary of the same
    shape, or a Topology. Each keyword replaces a top-level key of the file: `load("paper7", steps=300)`.
    Raises TopologyError with all mistakes, or UserError if there is no such file.
    """
    return resolved(network, _settings(overrides))


def simulate(network: Named, *, run_dir: str | Path | None = None, **overrides: object) -> RecordedRun:
    """Run a network in this process, without Zenoh, and return what it recorded.

    `network` and `overrides` are those of `load`. `law="hinf"` replaces the law, and `law=MyLaw` is a class of yours.
    If the file of a law changed since it was loaded, it is loaded again. `run_dir` is a new folder for the run, by
    default one in runs/. Warns if `network` is the folder of a run that kept another source of the law. Raises
    UserError for a mistake, LawError if the law fails, and HedgerowError if no step was made.
    """
    return simulation.simulate(network, *_settings(overrides), run_dir=run_dir)


def bound(network: Named, *, full: bool = False, **overrides: object) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law.

    `network` and `overrides` are those of `load`. `full` seeks a full storage matrix, for up to 30 nodes. A bound that
    cannot be computed is in `not_computed`, with the reason.
    """
    return bounds.bound(load(network, **overrides), full=full)


def worst(
    network: Named,
    *,
    budget: float = 60.0,
    faults: bool = False,
    seed: int = 0,
    out: str | Path | None = None,
    **overrides: object,
) -> Found:
    """Search for `budget` seconds the disturbance with the largest gain, and return it with a network that repeats it.

    `network` and `overrides` are those of `load`; `law="hinf"` attacks another law. `faults` searches cuts and drops
    too. `out` is the file of the network, beside which the search keeps its state, to go on later; by default nothing
    is written. Raises HedgerowError if no disturbance was found.
    """
    topology = checked(load(network, **overrides))
    return search(topology, budget, faults, seed, out=None if out is None else user_path(str(out)))


def _settings(overrides: Mapping[str, object]) -> list[str]:
    return [f"{key}={json.dumps(_named(value))}" for key, value in overrides.items()]


def _named(value: object) -> object:
    """Return a class, which stands for a law, as package.module:Class; any other value as it is."""
    return f"{value.__module__}:{value.__qualname__}" if isinstance(value, type) else value
