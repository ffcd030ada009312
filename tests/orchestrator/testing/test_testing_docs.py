"""docs/testing.md, run as a reader would: its programs are passing tests, and its failures show the text of the
page.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from hedgerow.orchestrator import testing
from hedgerow.orchestrator.launch.fault_verbs import FaultVerbs
from tests.tools.documents import ROOT, Scratch, blocks, commands, same_output, table

PAGE = ROOT / "docs" / "testing.md"


@pytest.mark.slow
def test_the_examples_are_tests_and_pass(tmp_path: Path) -> None:
    scratch = Scratch(tmp_path)
    scratch.environment["PYTEST_ADDOPTS"] = "-p no:cacheprovider -p no:hypothesispytest"
    shown = [block.name for block in blocks(PAGE) if block.language == "python"]
    assert len(shown) >= 5
    for block in blocks(PAGE):
        if block.language == "python":
            (tmp_path / block.name).write_text(block.text, encoding="utf-8")
    for block in blocks(PAGE):
        if block.language != "console":
            continue
        for command in re.findall(r"^\$ (pytest .*)$", block.text, re.MULTILINE):
            (call, claimed, output) = next(commands(block.text.replace("$ pytest", "$ orchestrator pytest")))
            code, printed = scratch.run("bash", "-c", call.removeprefix("orchestrator "))
            assert code == claimed, f"{command}: exit code {code}\n{printed}"
            assert same_output(output, printed), printed
            shown.remove(call.split()[-1])
    code, printed = scratch.run("pytest", "-q", *shown)
    assert code == 0, printed
    tests = sum(len(re.findall(r"^def test_", (tmp_path / name).read_text(), re.MULTILINE)) for name in shown)
    assert int(re.findall(r"(\d+) passed", printed)[0]) >= tests


def test_every_method_is_in_a_table() -> None:
    """The tables of the page name exactly the existing methods."""
    rows = [table("testing.md", "Reference", k) for k in range(3)]
    named = [set(re.findall(r"\b[a-z_]\w*", " ".join(next(iter(row.values())) for row in some))) for some in rows]
    assert named[1] <= {*dir(testing.Run), *testing.Run.__dataclass_fields__, "t", "i", "j", "node", "other"}
    for cls, words in zip((testing.Scenario, testing.Running), (named[0], named[2]), strict=True):
        own = vars(cls).keys() | (vars(FaultVerbs).keys() if cls is testing.Scenario else set())
        fields = getattr(cls, "__dataclass_fields__", {}).keys()
        public = {name for name in own | fields if not name.startswith("_")}
        assert public - words - _INSIDE[cls] == set(), cls
    parameters = set(inspect.signature(testing.Scenario.run).parameters) - {"self"}
    assert parameters <= named[0]


_INSIDE = {
    testing.Scenario: {"given", "new_folder", "on_result", "faults", "topology"},
    testing.Running: {"topology", "folder"},
}
"""Methods that a test does not need."""
