"""docs/data.md and the notebook agree with the code."""

from __future__ import annotations

import importlib
import itertools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from traitlets.config import Config

from hedgerow.orchestrator.runs.export import NAMES, arrays, export
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.recorded import RecordedRows
from hedgerow.orchestrator.runs.run import Run
from tests.tools.documents import ROOT, blocks, table
from tests.tools.recorded import same


def test_the_package_itself_loads_nothing() -> None:
    """Every command and every process imports it."""
    program = "import sys; before = set(sys.modules); import hedgerow.orchestrator; print({*sys.modules} - before)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(eval(loaded.stdout)) <= {"hedgerow", "hedgerow.orchestrator", "__future__"}


def test_the_page_names_every_array_and_its_shape(run: Run) -> None:
    """The table of arrays is that of the files, and of load_run."""
    rows = {row["name"]: row["shape"] for row in table("data.md", "Arrays")}
    sizes = {
        "T": run.T,
        "n": len(run.ids),
        "E": len(run.edges),
        "M": run.candidates.shape[1],
        "L": len(run.lost),
        "K": len(run.rows),
    }
    assert tuple(rows) == NAMES
    for name, values in arrays(run).items():
        shape = eval(rows[name], {}, sizes) if rows[name] != "—" else ()
        assert values.shape == (shape if isinstance(shape, tuple) else (shape,)), name


def test_the_page_names_every_attribute() -> None:
    """The page also names the attributes of Run beside the arrays."""
    public = {name for one in (Run, RecordedRows) for name in vars(one) if not name.startswith("_")}
    public |= Run.__dataclass_fields__.keys()
    tables = (table("data.md", "In Python"), table("data.md", "Runs with some rows only"))
    named = {row["attribute"].split("(")[0] for rows in tables for row in rows}
    assert named == public - set(NAMES)


def test_the_examples_agree(paper7: Run, here: Path) -> None:
    """All print the same of the same run; that for MATLAB too, where there is an Octave to run it."""
    page = list(blocks(ROOT / "docs/data.md"))
    pairs = [(code, text) for code, text in itertools.pairwise(page) if text.text.startswith("node ")]
    assert [code.language for code, _ in pairs] == ["python", "python", "python", "matlab"]
    assert len({text.text for _, text in pairs}) == 1
    if octave := shutil.which("octave-cli"):
        export(paper7, "mat", Path("run.mat"))
        program, shown = pairs[-1]
        command = [octave, "--norc", "--eval", program.text]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == shown.text


NOTEBOOK = ROOT / "docs/figure4.ipynb"


@pytest.mark.slow
def test_the_notebook_ends_with_figure_4(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The notebook runs in an empty folder; its last picture shows r_i(t) of all nodes."""
    nbformat, nbclient = importlib.import_module("nbformat"), importlib.import_module("nbclient")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(here / name.lower()))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    shown = "print(json.dumps([line.get_ydata().tolist() for line in axes.lines]))"
    notebook.cells.append(nbformat.v4.new_code_cell(f"import json\n{shown}"))
    through_files = Config(KernelManager={"transport": "ipc"})
    nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3", config=through_files).execute()
    *_, figure, drawn = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert any("image/png" in output.get("data", {}) for output in figure.outputs)
    lines = np.array(json.loads(drawn.outputs[-1].text))
    run = load_run(here / "runs/latest")
    assert same(lines.T, run.regret)
