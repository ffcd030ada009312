"""A folder that is gone, a path that is too long, an object that is no network: each is the user's mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import hedgerow as hg
from hedgerow.topologies.errors import Code, Exit, UserError
from tests.tools.processes import run_here

PAIR = {"name": "pair", "b": 0.1, "steps": 3, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "pair.yaml"),
        ("check", "paper7", "--law", "own:Law", "--import-law"),
        ("export", "DONE", "--to", "csv"),
        ("report", "DONE"),
        ("sweep", "paper7", "--seeds", "0:2"),
        ("worst", "paper7", "--budget", "0.1s"),
        ("keys", "paper7", "--out", "keys"),
    ],
    ids=lambda words: words[0],
)
def test_a_working_directory_that_was_removed_is_no_defect(
    here: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    done = hg.simulate(PAIR, run_dir=here / "done").folder
    gone = here / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    refused = run_here(*(str(done) if word == "DONE" else word for word in words))
    assert refused.returncode == Exit.USER_MISTAKE, refused.stderr
    monkeypatch.chdir(here)


@pytest.mark.parametrize("folder", ["x" * 300, "a/" * 3000, "mine/x"])
def test_a_run_folder_that_cannot_be_is_refused_in_python(here: Path, folder: str) -> None:
    (here / "mine").write_text(json.dumps(PAIR))
    with pytest.raises(UserError) as refused:
        hg.simulate(PAIR, run_dir=folder)
    assert refused.value.code == Code.OUTPUT


@pytest.mark.parametrize("network", [None, 3, [], b"paper7", object(), ["p", "q"], {"p"}, print])
def test_an_object_that_is_no_network_is_refused_in_python(here: Path, network: Any) -> None:
    with pytest.raises(UserError) as refused:
        hg.load(network)
    assert refused.value.code == Code.TOPOLOGY
