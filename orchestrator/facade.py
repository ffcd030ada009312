"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import json
from pathlib import Path

from hedgerow.agents.shard import law_class
from hedgerow.orchestrator.ground.assignment import law_of, layout
from hedgerow.orchestrator.launch.recording import Watching
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import RecordedRun, load_run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import HedgerowError
from hedgerow.topologies.load import Named, parse, text_of
from hedgerow.topologies.paths import user_path
from hedgerow.topologies.resolve import resolve
from hedgerow.topologies.schema import Topology

__all__ = ["load", "load_run", "simulate"]


def load(network: Named, **overrides: object) -> Topology:
    """Return a network with all numbers drawn.

    `network` is a bundled name, the path of a file or run folder, the YAML text of a file, a dictionary of the same
    shape, or a Topology. Each keyword replaces a top-level key of the file: `load("paper7", steps=300)`.
    Raises TopologyError with all mistakes, or UserError if there is no such file.
    """
    text, source, folder = text_of(network)
    settings = [f"{key}={json.dumps(value)}" for key, value in overrides.items()]
    return resolve(parse(text, source, folder, settings), folder)


def simulate(network: Named, *, run_dir: str | Path | None = None, **overrides: object) -> RecordedRun:
    """Run a network in this process, without Zenoh, and return what it recorded.

    `network` and `overrides` are those of `load`; `law="hinf"` replaces the law. `run_dir` is a new folder for the run,
    by default one in runs/. Raises UserError for a mistake, and HedgerowError if no step was made.
    """
    topology = load(network, **overrides)
    law_class(law_of(topology))  # a mistake in the law is reported before a folder is made
    folder = create(topology, None if run_dir is None else user_path(str(run_dir)))
    verdict = simulate_into(topology, folder, layout(topology, 1), Watching(record=False), Quiet())
    if not verdict.content["steps_done"]:
        raise HedgerowError(verdict.line())
    return load_run(folder.path)
