"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from hedgerow.orchestrator.experiments import bounds
from hedgerow.orchestrator.experiments.compare import Compared
from hedgerow.orchestrator.experiments.compare import compare as run_comparison
from hedgerow.orchestrator.experiments.compare.plan import comparison
from hedgerow.orchestrator.launch import simulation
from hedgerow.orchestrator.metrics.guarantee import Guarantee
from hedgerow.orchestrator.runs.reader import RecordedRun, load_run
from hedgerow.topologies.named import Named, resolved
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.schema import Topology

__all__ = ["bound", "compare", "load", "load_run", "simulate"]


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


def compare(
    network: Named,
    laws: Sequence[str] = ("minimax",),
    disturbances: Sequence[str | Mapping[str, object]] = ("file",),
    seeds: range = range(50),
    *,
    out: str | Path | None = None,
    jobs: int = 1,
    **overrides: object,
) -> Compared:
    """Run every law under every disturbance and seed, hinf and nominal too; return their means, tests and findings.

    `laws` are as in a file: `["minimax", "forgetting(decay=0.98)"]`. A disturbance is `file`, the name of a preset
    (`sinusoid`, `white`, `ar1`, `constant`, `confuse`, `none`), names joined by `+`, or a mapping as in a file. `out`
    is the folder of the results, which the same call finds again. With `jobs` above 1, processes share the runs; a
    script then needs `if __name__ == "__main__":`. Raises UserError for a mistake.
    """
    plan = comparison(network, laws, disturbances, seeds, _settings(overrides))
    found = run_comparison(plan, None if out is None else user_path(str(out)), jobs, quiet=True)
    if found is None:
        raise KeyboardInterrupt
    return found


def _settings(overrides: Mapping[str, object]) -> list[str]:
    return [f"{key}={json.dumps(value)}" for key, value in overrides.items()]
