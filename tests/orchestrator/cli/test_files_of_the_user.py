"""No command replaces or removes a file that it did not write, and any path of a user's gets an answer in words."""

from __future__ import annotations

import io
import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

import hedgerow as hg
from hedgerow.orchestrator.cli.exit_code import run_to_exit_code
from hedgerow.orchestrator.cli.main import app
from hedgerow.topologies.errors import Code, Exit, UserError
from hedgerow.topologies.paths import user_path

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}
WORST = ("worst", "pair.yaml", "--budget", "0.1s", "-q")


def run(*words: str) -> int:
    return run_to_exit_code(lambda: app([*words], standalone_mode=False) or 0)


@pytest.fixture
def pair(here: Path) -> Path:
    (here / "pair.yaml").write_text(json.dumps(PAIR))
    return here


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ["worst.yaml", "worst.json", "worst.npz"])
@pytest.mark.parametrize("content", [b"precious", b"{}", b"[1]", b""])
def test_a_search_replaces_no_file_of_the_users(pair: Path, name: str, content: bytes) -> None:
    (pair / name).write_bytes(content)
    before = contents(pair)
    assert run(*WORST) == Exit.USER_MISTAKE
    assert contents(pair) == before


def test_a_search_replaces_no_array_of_the_users(pair: Path) -> None:
    np.savez(pair / "worst.npz", edges=np.array([[0, 1]]))
    before = contents(pair)
    assert run(*WORST) == Exit.USER_MISTAKE
    assert contents(pair) == before


@pytest.mark.parametrize("out", ["pair.yaml", "x.json", "x.npz", ".", "..", "", "/"])
def test_a_search_writes_to_no_name_that_it_cannot_have(pair: Path, out: str) -> None:
    before = contents(pair)
    assert run(*WORST, "--out", out) == Exit.USER_MISTAKE
    assert contents(pair) == before


def test_a_search_goes_on_from_its_own_files_and_refuses_damaged_ones(pair: Path) -> None:
    assert run(*WORST) == Exit.VALID
    assert run(*WORST) == Exit.VALID
    state = (pair / "worst.npz").read_bytes()
    with np.load(io.BytesIO(state)) as kept:
        arrays = dict(kept)
    for name, wrong in (("m0", np.zeros((2, 2))), ("w0", np.full((3, 2), np.nan)), ("s0", np.zeros(5))):
        np.savez(pair / "worst.npz", **{**arrays, name: wrong})
        assert run(*WORST) == Exit.USER_MISTAKE, name
    (pair / "worst.npz").write_bytes(state[:-100])
    assert run(*WORST) == Exit.USER_MISTAKE


def old(folder: Path) -> Path:
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (1e9, 1e9))
    return folder


def test_runs_removes_no_folder_that_no_run_made(here: Path) -> None:
    (project := here / "project").mkdir()
    (project / "topology.yaml").write_text("of another tool")
    (project / "thesis.tex").write_text("precious")
    assert run("runs", ".", "--keep", "0") == Exit.VALID
    assert contents(project).keys() == {"topology.yaml", "thesis.tex"}


def test_runs_keeps_what_the_user_put_into_a_run(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = hg.simulate(PAIR).folder
    (folder / "notes.txt").write_text("precious")
    (folder / "telemetry.csv").write_text("exported")
    old(folder)
    assert run("runs", "--keep", "0") == Exit.VALID
    assert contents(folder).keys() == {"notes.txt", "telemetry.csv"}
    assert "notes.txt" in capsys.readouterr().err


def test_runs_follows_no_link_out_of_a_run(here: Path) -> None:
    (outside := here / "outside").mkdir()
    (outside / "mine").write_text("precious")
    folder = hg.simulate(PAIR).folder
    (folder / "logs").rename(here / "logs")
    (folder / "logs").symlink_to(outside)
    old(folder)
    run("runs", "--keep", "0")
    assert (outside / "mine").read_text() == "precious"


def test_a_run_without_a_verdict_is_removed_only_when_nothing_writes_to_it(here: Path) -> None:
    folder = hg.simulate(PAIR).folder
    (folder / "verdict.json").unlink()
    assert run("runs", "--keep", "0") == Exit.VALID
    assert folder.exists()
    old(folder)
    assert run("runs", "--keep", "0") == Exit.VALID
    assert not folder.exists()
    assert time.time() > 1e9


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_latest_is_replaced_only_if_it_is_a_link(here: Path, kind: str) -> None:
    (here / "runs").mkdir()
    latest = here / "runs/latest"
    latest.write_text("precious") if kind == "file" else latest.mkdir()
    hg.simulate(PAIR)
    assert latest.read_text() == "precious" if kind == "file" else latest.is_dir()
    assert not latest.is_symlink()


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is exported, and never changed."""
    return hg.simulate(PAIR, run_dir=tmp_path_factory.mktemp("exported") / "run").folder


LONG = "x" * 300
PATHS = (LONG, f"{LONG}/x", "pair.yaml/x", "/proc/x", "/dev/null/x", "~nobody-here/x", "caf\udce9", "a\nb", "#", "?x=1")


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "pair.yaml", "--no-record", "--run-dir"),
        ("export", "done", "--to", "csv", "--out"),
        ("export", "done", "--to", "npz", "--out"),
        ("export", "done", "--to", "mat", "--out"),
        ("export", "done", "--to", "parquet", "--out"),
        ("import", "edges.csv", "--out"),
        ("keys", "pair.yaml", "--router", "tls/127.0.0.1:7447", "--out"),
        ("bundle", "pair.yaml", "--router", "tcp/127.0.0.1:7447", "--out"),
        ("compose", "pair.yaml", "--out"),
        *((name,) for name in ("check", "import", "report", "runs", "status", "open", "watch", "bound", "audit")),
    ],
    ids=" ".join,
)
def test_any_path_gets_an_answer_in_words(
    pair: Path, exported: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], path: str
) -> None:
    (pair / "edges.csv").write_text("source,target\n1,2\n2,3\n")
    if words[0] == "export":
        (pair / "done").symlink_to(exported)
    assert run(*words, path) in (Exit.VALID, Exit.USER_MISTAKE)
    assert "defect" not in capsys.readouterr().err


@pytest.mark.parametrize("path", PATHS[:7])
def test_a_search_answers_any_path_in_words(pair: Path, capsys: pytest.CaptureFixture[str], path: str) -> None:
    assert pair.is_dir()
    assert run(*WORST, "--out", path) in (Exit.VALID, Exit.USER_MISTAKE)
    assert "defect" not in capsys.readouterr().err


def test_a_path_with_a_zero_byte_is_refused() -> None:
    with pytest.raises(UserError) as refused:
        user_path("a\0b")
    assert refused.value.code == Code.OPTION
