"""A defect in `hedgerow-agent` or `hedgerow-plant` is one line, a file with the traceback, and exit code 70."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hedgerow.topologies.errors import Exit
from tests.tools.processes import DEADLINE_S

FINDER = """
import sys
class Finder:
    def find_spec(self, name, *_):
        if name == {module!r}: raise {error}
sys.meta_path.insert(0, Finder())
"""
PLACES = {
    "while modules load": FINDER.format(module="hedgerow.wire.standalone", error="LookupError('planted')"),
    "while options are read": (
        "import argparse\ndef fail(*_): raise LookupError('planted')\nargparse.ArgumentParser.parse_args = fail\n"
    ),
    "while the config is read": (
        "import hedgerow.wire.config as config\ndef fail(*_): raise LookupError('planted')\nconfig.find = fail\n"
    ),
}


def run(program: str, before: str, folder: Path) -> subprocess.CompletedProcess[str]:
    text = f"{before}\nfrom hedgerow.{program}.command import main\nmain()"
    return subprocess.run(
        [sys.executable, "-P", "-c", text, "--config", "x.toml"],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
        env=os.environ | {"TMPDIR": str(folder)},
    )


@pytest.mark.parametrize("program", ["agents", "plant"])
@pytest.mark.parametrize("place", PLACES)
def test_a_defect_is_one_line_and_its_traceback_is_in_the_named_file(tmp_path: Path, program: str, place: str) -> None:
    done = run(program, PLACES[place], tmp_path)
    assert (done.returncode, done.stdout) == (Exit.CRASH, "")
    assert done.stderr.count("\n") == 1
    assert "LookupError: planted" in Path(done.stderr.split()[-1]).read_text()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        ("ModuleNotFoundError('x', name='zenoh')", Exit.USER_MISTAKE),
        ("MemoryError()", Exit.UNKNOWN),
        ("ImportError('x.so: failed to map segment from shared object')", Exit.UNKNOWN),
        ("KeyboardInterrupt()", 130),
    ],
)
def test_a_missing_package_and_a_limit_are_no_defects(tmp_path: Path, error: str, code: int) -> None:
    done = run("agents", FINDER.format(module="hedgerow.agents.standalone", error=error), tmp_path)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
