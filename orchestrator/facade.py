"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from hedgerow.orchestrator.experiments import bounds
from hedgerow.orchestrator.launch import simulation
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.runs.reader import RecordedRun, load_run
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.schema import Topology

__all__ = ["bound", "load", "load_run", "simulate"]


def load(network: Named, **overrides: object) -> Topology:
    """Return a network with all numbers drawn.

    `network` is a bundled name, the path of a file or run folder, the YAML text of a file, a dictionary of the same
    shape, or a Topology. Each keyword replaces a top-level key of the file: `load("paper7", steps=300)`.
    Raises TopologyError with all mistakes, or UserError if there is no such file.
    """
    return resolved(network, _settings(overrides))


def simulate(network: Named, *, run_dir: str | Path | None = None, **overrides: object) -> RecordedRun:
    """Run a network in this process, without Zenoh, and return what it recorded.

    `network` and `overrides` are those of `load`; `law="hinf"` replaces the law. `run_dir` is a new folder for the run,
    by default one in runs/. Raises UserError for a mistake, and HedgerowError if no step was made.
    """
    return simulation.simulate(network, *_settings(overrides), run_dir=run_dir)


def bound(network: Named, *, full: bool = False, **overrides: object) -> Guarantee:
    """Return gamma* of a network, and upper bounds on the gain of the adaptive law.

    `network` and `overrides` are those of `load`. `full` seeks a full storage matrix, for up to 30 nodes. A bound that
    cannot be computed is in `not_computed`, with the reason.
    """
    return bounds.bound(load(network, **overrides), full=full)


def _settings(overrides: Mapping[str, object]) -> list[str]:
    return [f"{key}={json.dumps(value)}" for key, value in overrides.items()]
