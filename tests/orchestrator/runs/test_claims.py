"""Two runs that ask for one folder at the same moment: one has it, and the other leaves it alone."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from hedgerow.orchestrator.runs import folder as folders
from hedgerow.orchestrator.runs.folder import RunFolder, create
from hedgerow.topologies.errors import Code, UserError
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve


@pytest.mark.parametrize("exists", [False, True])
def test_one_of_two_runs_has_the_folder(here: Path, monkeypatch: pytest.MonkeyPatch, exists: bool) -> None:
    topology = resolve(load("paper7"))
    if exists:
        (here / "run").mkdir()
    both = threading.Barrier(2)
    looked = folders.new_folder

    def look(*words: object) -> None:
        looked(*words)  # type: ignore[arg-type]
        both.wait(10)  # both have seen an empty folder

    monkeypatch.setattr(folders, "new_folder", look)
    results: list[RunFolder | UserError] = []

    def run() -> None:
        try:
            results.append(create(topology, Path("run")))
        except UserError as error:
            results.append(error)

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    refused = [one for one in results if isinstance(one, UserError)]
    assert [one.code for one in refused] == [Code.OUTPUT]
    assert sorted(path.name for path in (here / "run").iterdir()) == ["logs", "processes", "topology.yaml"]
