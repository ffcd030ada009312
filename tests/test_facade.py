"""The functions of `import hedgerow as hg`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hedgerow as hg

PAIR = {"name": "pair", "b": 0.1, "steps": 6, "seed": 3, "nodes": ["p", "q"], "edges": [["p", "q"]]}


def test_every_public_name_is_there_and_no_other() -> None:
    assert all(getattr(hg, name) is not None for name in hg.__all__)
    assert hg.__version__
    with pytest.raises(AttributeError):
        _ = hg.nothing


def test_the_import_loads_nothing() -> None:
    program = "import sys; import hedgerow; print({'numpy', 'pydantic', 'zenoh', 'typing'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-I", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("steps", [5, None])
def test_a_network_is_a_name_a_path_a_text_a_dictionary_or_a_topology(here: Path, steps: int | None) -> None:
    text = "{name: pair, b: 0.1, steps: 6, seed: 3, nodes: [p, q], edges: [[p, q]]}"
    Path("pair.yaml").write_text(text)
    overrides = {} if steps is None else {"steps": steps}
    loaded = [hg.load(one, **overrides) for one in ("pair.yaml", Path("pair.yaml"), text, PAIR, hg.load(PAIR))]
    assert all(one == loaded[0] for one in loaded)
    assert loaded[0].steps == (steps or 6)
    assert hg.load("paper7").name == "paper7"


def test_a_simulated_run_is_the_run_that_its_folder_holds(here: Path) -> None:
    run = hg.simulate(PAIR, run_dir="first", law="hinf")
    np.testing.assert_array_equal(run.x, hg.load_run("first").x)
    assert run.T == 6


def test_a_mistake_has_a_code(here: Path) -> None:
    with pytest.raises(hg.UserError):
        hg.load("nowhere.yaml")
    with pytest.raises(hg.TopologyError) as raised:
        hg.load(PAIR, b=2.0)
    assert raised.value.code in hg.Code


def test_a_file_that_no_command_reads_is_refused_here_as_well(here: Path) -> None:
    for load in (hg.load, hg.simulate):
        with pytest.raises(hg.UserError) as raised:
            load("/dev/zero")
        assert raised.value.code == hg.Code.FILE_NOT_REGULAR
