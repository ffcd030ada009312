"""The source of a law is part of a run: stored, compared, and always current."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from itertools import count
from pathlib import Path

import pytest

import hedgerow as hg
from hedgerow.agents.law_source import source_of
from hedgerow.agents.process import Agent, Begin, Joined
from hedgerow.agents.view import View
from hedgerow.orchestrator.deploy.bundle import write
from hedgerow.orchestrator.experiments.sweep import sweep
from hedgerow.orchestrator.experiments.sweep.plan import plan
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.ground.law_source import LawSource
from hedgerow.orchestrator.launch.external_agents import configs
from hedgerow.topologies.errors import Code, UserError
from tests.tools.processes import orchestrator
from tests.tools.refusals import refusal

LAW = """
from hedgerow.agents.law import Minimax
from gains_of_mine import GAIN

class Mine(Minimax):
    def act(self, x):
        return {factor} * GAIN * super().act(x)
"""


EDITS = count()


def edit(here: Path, factor: float, gain: float = 1.0) -> None:
    """Write the law and its module with equal sizes and with times in one second, as after a fast edit."""
    second = int(time.time()) * 10**9 + 10**6 * next(EDITS)
    for name, text in {"kept_law.py": LAW.format(factor=factor), "gains_of_mine.py": f"GAIN = {gain}\n"}.items():
        (here / name).write_text(text)
        os.utime(here / name, ns=(second, second))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("kept_law", "gains_of_mine", "deep_gain"):
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
    with pytest.warns(UserWarning, match="kept_law=True"):
        hg.simulate("first")
    done = orchestrator("simulate", "first", "--no-record")
    assert done.returncode == 0
    assert "--kept-law" in done.stderr + done.stdout
    (here / "kept_law.py").unlink()
    done = orchestrator("simulate", "first", "--no-record")
    assert done.returncode == 2
    assert "--kept-law" in done.stderr


@pytest.mark.parametrize("missing", [False, True], ids=["edited", "missing"])
def test_the_kept_law_runs_where_it_is_asked_for(here: Path, missing: bool) -> None:
    first = hg.simulate("paper7", law="kept_law:Mine", steps=3, run_dir="first")
    edit(here, 0.7)
    if missing:
        (here / "kept_law.py").unlink()
        del sys.modules["kept_law"]
    again = hg.simulate("first", kept_law=True)
    assert again.u.tolist() == first.u.tolist()
    assert again.verdict.content["law_source"] == first.verdict.content["law_source"]
    if not missing:  # the edited one is back
        assert hg.simulate("paper7", law="kept_law:Mine", steps=3).u.tolist() != first.u.tolist()
    for words in (["simulate"], ["up", "--viewer", "none", "--verify"]):
        done = orchestrator(words[0], "first", "--kept-law", "--no-record", "--run-dir", words[0], *words[1:])
        assert done.returncode == 0, done.stderr + done.stdout
        assert hg.load_run(words[0]).u.tolist() == first.u.tolist()


def test_a_run_without_a_law_of_its_own_keeps_none(here: Path) -> None:
    hg.simulate("paper7", steps=3, run_dir="first")
    with pytest.raises(UserError) as refused:
        hg.simulate("first", kept_law=True)
    assert refused.value.code == Code.LAW
    assert orchestrator("simulate", "first", "--kept-law", "--no-record").returncode == 2


def test_an_agent_refuses_another_source_than_the_operators(here: Path) -> None:
    topology = hg.load("paper7", law="kept_law:Mine")
    view = View.from_dict(configs(topology, layout(topology, 7), "tcp/localhost:7447", "n")[1].part)
    assert view.law_source
    edit(here, 0.7)
    with pytest.raises(UserError) as refused:
        Agent(view, "n", "tcp/localhost:1", Begin(lambda _: Joined(0), 0.1))
    assert refused.value.code == Code.LAW


def test_modules_that_a_law_uses_later_are_part_of_its_source(here: Path) -> None:
    (here / "lazy").mkdir()
    (here / "lazy" / "__init__.py").write_text("")
    (here / "lazy" / "inner.py").write_text("X = 1\n")
    text = "def later():\n    from lazy import inner\n    return inner.X\n"
    (here / "kept_law.py").write_text(LAW.format(factor=0.5) + text)
    assert set(source_of("kept_law:Mine").files) == {
        *("kept_law.py", "gains_of_mine.py", "lazy/__init__.py", "lazy/inner.py")
    }


def test_a_module_between_the_law_and_an_edited_one_is_loaded_again(here: Path) -> None:
    (here / "gains_of_mine.py").write_text("from deep_gain import GAIN\n")
    for name, factor in (("first", 1.0), ("second", 1.4)):
        (here / "deep_gain.py").write_text(f"GAIN = {factor}\n")
        hg.simulate("paper7", law="kept_law:Mine", steps=3, run_dir=name)
    assert hg.load_run("first").u[0].tolist() != hg.load_run("second").u[0].tolist()


def test_a_sweep_does_not_resume_with_another_source(here: Path) -> None:
    def swept() -> int:
        made = plan("paper7", "0:2", ["law=kept_law:Mine", "steps=3"], "in-process")
        return sweep(made, here / "out", jobs=1).exit_code

    assert swept() == 0
    assert LawSource.read(here / "out" / "law").files
    assert json.loads((here / "out" / "sweep.json").read_text())["laws"]
    assert swept() == 0
    edit(here, 0.7)
    with refusal(Code.OUTPUT, f"--out {here / 'out'}"):
        swept()


def test_a_bundle_carries_the_law(here: Path) -> None:
    topology = hg.load("paper7", law="kept_law:Mine")
    (here / "bundle").mkdir()
    write(here / "bundle", topology, configs(topology, layout(topology, 7), "tcp/localhost:7447", "n"))
    assert set(LawSource.read(here / "bundle").files) == {"kept_law.py", "gains_of_mine.py"}
    assert "kept_law.py" in (here / "bundle" / "README.md").read_text()


def test_a_wrong_edit_is_refused_at_its_line(here: Path) -> None:
    hg.simulate("paper7", law="kept_law:Mine", steps=3)
    (here / "kept_law.py").write_text("class Mine(:\n")
    with pytest.raises(UserError) as refused:
        hg.simulate("paper7", law="kept_law:Mine", steps=3)
    assert refused.value.code == Code.LAW


def test_agents_find_a_law_beside_the_script_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The script is started from elsewhere, so the law is not in the working directory."""
    scripts, elsewhere = tmp_path / "scripts", tmp_path / "elsewhere"
    scripts.mkdir()
    elsewhere.mkdir()
    (scripts / "law_beside.py").write_text("import hedgerow as hg\n\nclass Mine(hg.Minimax):\n    pass\n")
    monkeypatch.syspath_prepend(scripts)
    monkeypatch.chdir(elsewhere)
    law = importlib.import_module("law_beside").Mine
    assert hg.run("paper7", law=law, steps=3, processes=1).verdict.verdict == "valid"
