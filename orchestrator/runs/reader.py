"""The reader of run folders."""

from __future__ import annotations

from pathlib import Path

from hedgerow.orchestrator.metrics.verdict import Verdict
from hedgerow.orchestrator.runs.files import find_run, load_events, load_resolved, read_verdict
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.runs.table import Table, there_is
from hedgerow.topologies.errors import Code, UserError

TABLES = ("telemetry", "edges", "summary")


def load_run(run: str | Path = "runs/latest") -> Run:
    """Return the run in a folder, with the steps that are recorded so far.

    `run` is a run folder, the name of one in runs/, or the name of a network, which means its newest run in runs/.
    Raises UserError if there is no such run, or no recorded step yet.
    """
    folder = find_run(run)
    tables = {name: Table(folder, name) for name in TABLES if name != "summary" or there_is(folder, name)}
    # Read the topology after the tables: a run in progress may add faults to it, before the steps that they affect.
    topology, verdict = load_resolved(folder), read_verdict(folder)
    if verdict and len(verdict["faults"]) != len(topology.faults):
        raise UserError(
            f"{folder / 'verdict.json'}: has {len(verdict['faults'])} faults, and topology.yaml {len(topology.faults)}."
            " The two files are of different runs: restore the right one.",
            code=Code.FILE_FORMAT,
        )
    return Run(folder, topology, Verdict(verdict.get("verdict", ""), dict(verdict)), load_events(folder), tables)
