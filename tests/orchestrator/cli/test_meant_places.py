"""A place, an id or a class that is a little wrong: the fix names what is there, and removes nothing of the user's."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest

from hedgerow.orchestrator.cli.exit_code import run_to_exit_code
from hedgerow.orchestrator.cli.main import app
from hedgerow.topologies.errors import Code, Exit, TopologyError, UserError
from hedgerow.topologies.law_choice import LawChoice
from hedgerow.topologies.load import load
from hedgerow.topologies.paths import why_no_folder
from hedgerow.topologies.regular_file import check_regular

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["Genf", "Bern"], "edges": [["Genf", "Bern"]]}


def run(*words: str) -> int:
    return run_to_exit_code(lambda: app([*words], standalone_mode=False) or 0)


def cure(network: dict[str, object], file: Path) -> str:
    file.write_text(json.dumps(network))
    with pytest.raises(TopologyError) as refused:
        load(str(file))
    (problem,) = refused.value.problems
    return problem.cure


@pytest.mark.parametrize("device", ["/dev/null", "/dev/zero", "/"])
def test_no_message_asks_to_remove_a_device_or_a_folder(device: str) -> None:
    with pytest.raises(UserError) as refused:
        check_regular(Path(device))
    assert refused.value.code == Code.FILE_NOT_REGULAR
    assert "remove" not in str(refused.value).lower()


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "pair.yaml", "--run-dir", "precious"),
        ("sweep", "pair.yaml", "--seeds", "0:1", "--out", "precious"),
        ("compare", "pair.yaml", "--seeds", "0:2", "--out", "precious"),
        ("bundle", "pair.yaml", "--out", "precious"),
    ],
)
def test_a_file_in_the_place_of_a_folder_stays(
    here: Path, command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "pair.yaml").write_text(json.dumps(PAIR))
    (here / "precious").write_text("precious")
    assert run(*command) == Exit.USER_MISTAKE
    assert why_no_folder(FileExistsError()) in capsys.readouterr().err
    assert (here / "precious").read_text() == "precious"


def test_an_unknown_end_of_an_edge_has_the_node_of_a_like_name(here: Path) -> None:
    assert "'Genf'" in cure(PAIR | {"edges": [["Gnf", "Bern"]]}, here / "pair.yaml")
    assert "'" not in cure(PAIR | {"edges": [["Xyzzy", "Bern"]]}, here / "pair.yaml")


def test_many_unknown_ends_take_no_longer_than_a_few(here: Path) -> None:
    nodes = [f"node-{k}" for k in range(1000)]
    edges = [[nodes[k], nodes[k + 1]] for k in range(999)] + [[f"nod-{k}", "node-0"] for k in range(2000)]
    (here / "many.yaml").write_text(json.dumps(PAIR | {"nodes": nodes, "edges": edges}))
    began = time.process_time()
    with pytest.raises(TopologyError) as refused:
        load(str(here / "many.yaml"))
    assert refused.value.count >= 2000
    assert time.process_time() - began < 20  # without the limit it would be minutes


@pytest.mark.parametrize("written", ["lone.Power", "my.laws.Power", "/tmp/lone.py:Power"])
def test_a_class_that_is_written_otherwise_has_its_choice(written: str) -> None:
    with pytest.raises(ValueError, match="write ") as refused:
        LawChoice.parse(written)
    meant = re.search(r"write ([\w.:]+)", str(refused.value))
    assert meant is not None
    assert LawChoice.parse(meant[1]).name == meant[1]


@pytest.mark.parametrize("written", ["lone.py", "1.5", "a.", "", "..", "a b"])
def test_a_name_that_is_no_class_has_no_choice(written: str) -> None:
    with pytest.raises(ValueError, match="is ") as refused:
        LawChoice.parse(written)
    assert "write" not in str(refused.value)
