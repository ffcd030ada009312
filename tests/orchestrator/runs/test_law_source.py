"""The source of a law is part of a run: kept, compared, and never a stale one."""

from __future__ import annotations

import json
import os
import sys
import time
from itertools import count
from pathlib import Path

import pytest

import hedgerow as hg
from hedgerow.orchestrator.deploy.bundle import write
from hedgerow.orchestrator.experiments.sweep import sweep
from hedgerow.orchestrator.experiments.sweep.plan import plan
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.ground.law_source import LawSource
from hedgerow.orchestrator.launch.external_agents import configs
from hedgerow.topologies.errors import Code, UserError
from tests.tools.processes import orchestrator

LAW = """
from hedgerow.agents.law import Minimax
from gains_of_mine import GAIN

class Mine(Minimax):
    def act(self, x):
        return {factor} * GAIN * super().act(x)
"""


EDITS = count()


def edit(here: Path, factor: float, gain: float = 1.0) -> None:
    """Write the law and its module, of the same size and with times in one second, as a quick edit leaves them."""
    second = int(time.time()) * 10**9 + 10**6 * next(EDITS)
    for name, text in {"kept_law.py": LAW.format(factor=factor), "gains_of_mine.py": f"GAIN = {gain}\n"}.items():
        (here / name).write_text(text)
        os.utime(here / name, ns=(second, second))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("kept_law", "gains_of_mine"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    edit(tmp_path, 0.5)
    return tmp_path


def test_a_run_keeps_the_files_of_its_law_and_their_digest(here: Path) -> None:
    run = hg.simulate("paper7", law="kept_law:Mine", steps=3)
    kept = LawSource.read(run.folder / "law")
    assert set(kept.files) == {"kept_law.py", "gains_of_mine.py"}
    assert kept.files["kept_law.py"] == (here / "kept_law.py").read_bytes()
    assert run.verdict.content["law_source"] == kept.digest
    assert hg.simulate("paper7", steps=3).verdict.content["law_source"] is None


@pytest.mark.parametrize("edited", [(0.7, 1.0), (0.5, 1.4)], ids=["law", "module that it uses"])
def test_an_edited_law_is_the_one_that_runs(here: Path, edited: tuple[float, float]) -> None:
    first = hg.simulate("paper7", law="kept_law:Mine", steps=3)
    edit(here, *edited)
    second = hg.simulate("paper7", law="kept_law:Mine", steps=3)
    assert second.u[0].tolist() != first.u[0].tolist()
    assert second.verdict.content["law_source"] != first.verdict.content["law_source"]


def test_a_class_of_a_notebook_is_the_one_that_runs(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = hg.simulate("paper7", law="hinf", steps=3)
    for factor in (0.5, 0.7):
        cell: dict[str, object] = {"__name__": "__main__"}
        exec(LAW.format(factor=factor), cell)
        monkeypatch.setattr(sys.modules["__main__"], "Mine", cell["Mine"], raising=False)
        run = hg.simulate("paper7", law=cell["Mine"], steps=3)
        assert run.u[0].tolist() != first.u[0].tolist()
        first = run


def test_a_run_is_repeated_with_a_warning_if_its_law_is_another(here: Path) -> None:
    hg.simulate("paper7", law="kept_law:Mine", steps=3, run_dir="first")
    hg.simulate("first")  # no warning: it is the same
    edit(here, 0.7)
    with pytest.warns(UserWarning, match="PYTHONPATH="):
        hg.simulate("first")
    done = orchestrator("simulate", "first", "--no-record")
    assert done.returncode == 0
    assert f"PYTHONPATH={here / 'first' / 'law'}" in done.stderr + done.stdout
    (here / "kept_law.py").unlink()
    done = orchestrator("simulate", "first", "--no-record")
    assert done.returncode == 2
    assert "PYTHONPATH=" in done.stderr


def test_a_sweep_does_not_resume_with_another_source(here: Path) -> None:
    def swept() -> int:
        made = plan("paper7", "0:2", ["law=kept_law:Mine", "steps=3"], "in-process")
        return sweep(made, here / "out", jobs=1).exit_code

    assert swept() == 0
    assert LawSource.read(here / "out" / "law").files
    assert json.loads((here / "out" / "sweep.json").read_text())["laws"]
    assert swept() == 0
    edit(here, 0.7)
    with pytest.raises(UserError, match="source of its law"):
        swept()


def test_a_bundle_carries_the_law_and_containers_refuse_it(here: Path) -> None:
    topology = hg.load("paper7", law="kept_law:Mine")
    (here / "bundle").mkdir()
    write(here / "bundle", topology, configs(topology, layout(topology, 7), "tcp/localhost:7447", "n"))
    assert set(LawSource.read(here / "bundle").files) == {"kept_law.py", "gains_of_mine.py"}
    assert "kept_law.py" in (here / "bundle" / "README.md").read_text()
    done = orchestrator("compose", "paper7", "--law", "kept_law:Mine")
    assert done.returncode == 2
    assert "orchestrator bundle" in done.stderr


def test_a_wrong_edit_is_refused_at_its_line(here: Path) -> None:
    hg.simulate("paper7", law="kept_law:Mine", steps=3)
    (here / "kept_law.py").write_text("class Mine(:\n")
    with pytest.raises(UserError) as refused:
        hg.simulate("paper7", law="kept_law:Mine", steps=3)
    assert refused.value.code == Code.LAW
