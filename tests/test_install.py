"""An installation puts one package into site-packages, and a user's own modules keep their names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

import hedgerow
from tests.tools.processes import COMMAND

ROOT = Path(__file__).parents[1]
LAW = """import plant
from hedgerow.agents.law import Minimax

class Mine(Minimax):
    kept = plant.KEPT
"""
UP = ("--viewer", "none", "--no-record", "--steps", "5")


@pytest.fixture
def project(here: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of the user's with modules of our folders' names."""
    for package in ("orchestrator", "agents", "wire", "topologies"):
        (here / package).mkdir()
        (here / package / "__init__.py").write_text("raise ImportError('the user own, and not asked for')\n")
    (here / "plant.py").write_text("KEPT = 3\n")
    (here / "mylaws.py").write_text(LAW)
    monkeypatch.setenv("PYTHONPATH", str(here))
    return here


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.parametrize("verb", [("simulate", "paper7", "--no-record", "--steps", "5"), ("up", "paper7", *UP)])
def test_a_law_that_imports_a_plant_of_the_users_gets_it(project: Path, verb: tuple[str, ...]) -> None:
    done = run(*COMMAND, *verb, "--law", "mylaws:Mine")
    assert done.returncode == 0, done.stdout + done.stderr


def test_pytest_starts_in_a_project_with_our_folders_names(project: Path) -> None:
    (project / "test_one.py").write_text(
        "import plant\n\ndef test_one(network):\n"
        "    assert plant.KEPT == 3\n    assert network('paper7').run(steps=3).verdict.verdict == 'valid'\n"
    )
    done = run(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_one.py")
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_plugin_loads_nothing_large_in_a_project_that_does_not_use_it(here: Path) -> None:
    (here / "test_one.py").write_text(
        "import sys\n\ndef test_one():\n"
        "    assert not {'pydantic', 'rerun', 'zenoh', 'numpy', 'typer', 'yaml'} & set(sys.modules)\n"
    )
    plain = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "hedgerow.orchestrator.testing.pytest_plugin", "test_one.py"],
        capture_output=True,
        text=True,
        check=False,
        env=plain,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_an_installation_adds_no_command_with_a_general_name() -> None:
    scripts = metadata.distribution("hedgerow").entry_points.select(group="console_scripts")
    assert {script.name for script in scripts} == {"orchestrator", "hedgerow", "hedgerow-agent", "hedgerow-plant"}


def test_the_message_for_a_missing_package_covers_all_that_an_agent_does_without() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    imported = {"rerun-sdk": "rerun", "pyyaml": "yaml", "eclipse-zenoh": "zenoh"}
    names = {re.split("[<>=]", one)[0] for one in project["dependencies"]}
    assert {imported.get(name, name) for name in names} - {"numpy", "zenoh"} == hedgerow.NEEDED


@pytest.mark.parametrize("package", ["orchestrator", "agents", "plant"])
def test_a_clone_without_an_installation_gives_one_line(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    done = run(sys.executable, "-S", "-m", f"hedgerow.{package}")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert done.stderr.startswith("error: ")


def test_a_missing_package_is_named_in_python(tmp_path: Path) -> None:
    program = "import sys; sys.modules['pydantic'] = None; import hedgerow; hedgerow.load"
    done = run(sys.executable, "-c", program)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ModuleNotFoundError: hedgerow.load needs pydantic")


@pytest.mark.slow
@pytest.mark.skipif("HEDGEROW_NETWORK_TESTS" not in os.environ, reason="downloads packages; set HEDGEROW_NETWORK_TESTS")
@pytest.mark.parametrize("order", [("openai-agents", str(ROOT)), (str(ROOT), "openai-agents")])
def test_it_works_beside_the_openai_agents_sdk_in_either_order(tmp_path: Path, order: tuple[str, str]) -> None:
    python = str(tmp_path / "bin/python")
    assert run(sys.executable, "-m", "venv", str(tmp_path)).returncode == 0
    for package in order:
        done = run(python, "-m", "pip", "install", "-q", package)
        assert done.returncode == 0, done.stderr
    program = "import agents, hedgerow; agents.Agent, hedgerow.load('paper7')"
    done = run(python, "-P", "-c", program)
    assert done.returncode == 0, done.stderr
