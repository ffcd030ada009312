"""The map of a step in CONTRIBUTING.md lists the functions that run, in their order.

The processes of a run record each call of a function on the map.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.tools.processes import COMMAND, DEADLINE_S

TEXT = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
SECTIONS = {part.partition("\n")[0]: part for part in re.split(r"^### ", TEXT, flags=re.MULTILINE)}
STEPS, SETTLED = 16, 7
"""The steps of a run, and the first step that is undisturbed in every process."""
RECORDER = """
import importlib, functools, os
for file, path in {functions!r}:
    owner, name = path.split(".")
    owner = getattr(importlib.import_module("hedgerow." + file.replace("/", ".")), owner)
    whole = getattr(owner, name)
    def recorded(*a, _whole=whole, _path=path, **k):
        with open(os.environ["CALLS"] + "/" + str(os.getpid()), "a") as file:
            print(_path, file=file)
        return _whole(*a, **k)
    setattr(owner, name, functools.wraps(whole)(recorded))
"""


def hops(heading: str) -> dict[str, str]:
    """The functions of a table with hops, by hop."""
    return dict(re.findall(r"^\| (\w+) \| \[`([\w.]+)`\]", SECTIONS[heading], re.MULTILINE))


QUIET, GENERAL = hops("When nothing fails"), hops("The general path")
GAPS = "FloatLaw.step_with_gaps"


def calls(folder: Path, *arguments: str) -> list[list[str]]:
    """The recorded calls of a run, by process."""
    functions = sorted({(file, name) for name, file in re.findall(r"\[`(\w+\.\w+)`\]\((\w+/\w+)\.py\)", TEXT)})
    (folder / "calls").mkdir()
    (folder / "sitecustomize.py").write_text(RECORDER.format(functions=functions))
    command = [*COMMAND, "up", "paper7", "--steps", str(STEPS), "--viewer", "none", "--no-record", *arguments]
    environment = os.environ | {"PYTHONPATH": str(folder), "CALLS": str(folder / "calls")}
    subprocess.run(
        [*command, "--run-dir", str(folder / "run")],
        check=True,
        capture_output=True,
        env=environment,
        timeout=DEADLINE_S,
        cwd=folder,
    )
    return [path.read_text().split() for path in sorted((folder / "calls").iterdir())]


def steps_of(calls: Sequence[str], first: str) -> list[list[str]]:
    """The calls of a process from each call of one function to the next."""
    starts = [k for k, name in enumerate(calls) if name == first]
    return [list(calls[start:stop]) for start, stop in zip(starts, [*starts[1:], len(calls)], strict=True)]


def answers(agent: Sequence[str]) -> list[list[str]]:
    """The calls of an agent by step, each once; a state that the plant repeated has no calls of a step."""
    made = [list(dict.fromkeys(step)) for step in steps_of(agent, QUIET["3"])]
    return [step for step in made if {GENERAL["5a"], QUIET["5"], GAPS} & {*step}]


def general(step: Sequence[str]) -> list[str]:
    return [name for name in step if name in {*GENERAL.values(), GAPS}]


def agents_of(found: list[list[str]]) -> list[list[str]]:
    return [one for one in found if QUIET["3"] in one]


def test_an_undisturbed_run_takes_the_hops_of_the_map(tmp_path: Path) -> None:
    found = calls(tmp_path)
    agents = agents_of(found)
    assert len(agents) == 7
    for agent in agents:
        steps = answers(agent)
        assert len(steps) == STEPS
        assert GENERAL["5c"] in steps[0]
        assert all(general(step) == [*GENERAL.values()] for step in steps[1:5])
        assert all(QUIET["5"] in step for step in steps[5:])
        assert not any({GENERAL["5b"], GENERAL["5c"]} & set(step) for step in steps[5:])
        in_time = [step for step in steps[5:] if GENERAL["4a"] not in step]
        assert all(step[:3] == [QUIET["3"], QUIET["4"], QUIET["5"]] for step in in_time)
        assert QUIET["6"] in agent
    (plant,) = (one for one in found if QUIET["8"] in one)
    for step in steps_of(plant, QUIET["1"])[SETTLED : STEPS - 1]:
        own = [name for name in dict.fromkeys(step) if name in QUIET.values() and name != QUIET["7"]]
        assert own == [QUIET[hop] for hop in ("1", "2", "10", "8", "9")]
        assert step.count(QUIET["7"]) >= 7


@pytest.mark.parametrize("kind", ["drop", "delay, by: 2"])
def test_a_missing_message_is_learned_in_floats(tmp_path: Path, kind: str) -> None:
    agents = agents_of(calls(tmp_path, "--set", f"faults=[{{kind: {kind}, link: [2, 4], steps: [8, 12]}}]"))
    gaps = [step for agent in agents for step in answers(agent)[SETTLED:] if GAPS in step]
    assert gaps
    way = [GENERAL[hop] for hop in ("4a", "4b", "5a", "5d")]
    ways = [[name for name in general(step) if name != GAPS] for step in gaps]
    assert all(one in ([], way) for one in ways)
    assert [] in ways


def test_another_law_learns_a_missing_message_in_numpy(tmp_path: Path) -> None:
    drop = "faults=[{kind: drop, link: [2, 4], steps: [8, 12]}]"
    agents = agents_of(calls(tmp_path, "--law", "notch", "--set", drop))
    steps = [step for agent in agents for step in answers(agent)[SETTLED:]]
    assert any([name for name in general(step) if name != GAPS] == [*GENERAL.values()] for step in steps)
