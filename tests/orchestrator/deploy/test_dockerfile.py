"""The Dockerfile: the rules of a linter, and its steps, executed without an engine."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from dockerfile_parse import DockerfileParser
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.tools.machines import ROOT
from tests.tools.processes import Orchestrator, orchestrator

Instruction = dict[str, Any]
STAGES = ("base", "build", "agent", "orchestrator")


@pytest.fixture(scope="module")
def stages() -> dict[str, list[Instruction]]:
    """The instructions of each stage, by its name."""
    found: dict[str, list[Instruction]] = {}
    for instruction in DockerfileParser(str(ROOT / "Dockerfile"), env_replace=False).structure:
        if instruction["instruction"] == "FROM":
            found[instruction["value"].rpartition(" AS ")[2]] = []
        if instruction["instruction"] != "COMMENT":
            list(found.values())[-1].append(instruction)
    return found


def values(stage: list[Instruction], kind: str) -> list[str]:
    return [one["value"] for one in stage if one["instruction"] == kind]


def test_the_base_is_pinned_and_the_other_stages_use_it(stages: dict[str, list[Instruction]]) -> None:
    assert tuple(stages) == STAGES
    assert re.fullmatch(r"python:\d+\.\d+\.\d+-slim-\w+ AS base", values(stages["base"], "FROM")[0])
    assert all(values(stages[name], "FROM") == [f"base AS {name}"] for name in STAGES[1:])


@pytest.mark.parametrize("name", ["agent", "orchestrator"])
def test_the_final_image_is_not_root_and_has_no_build_tools(stages: dict[str, list[Instruction]], name: str) -> None:
    stage = stages[name]
    assert values(stage, "USER") == ["hedgerow"]
    assert values(stage, "COPY") == [f"--from=build /opt/{name} /opt/{name}"]
    assert not any(tool in run for run in values(stage, "RUN") for tool in ("pip", "apt", "curl"))
    assert json.loads(values(stage, "CMD")[-1])
    assert not [one for part in stages.values() for one in part if one["instruction"] == "ADD"]


def test_copied_files_exist_and_are_sent_to_the_engine(stages: dict[str, list[Instruction]]) -> None:
    sent = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {word for copy in values(stages["build"], "COPY") for word in copy.split()[:-1]}
    assert copied == sent
    assert all((ROOT / name).exists() for name in copied)


def needed(name: str, extras: set[str], found: set[str]) -> set[str]:
    """Return `found` and the further requirements of a package with some extras, from the installed metadata."""
    for printed in metadata.distribution(name).requires or ():
        one = Requirement(printed)
        other = canonicalize_name(one.name)
        if other not in found and (
            one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras | {""})
        ):
            found.add(other)
            needed(other, one.extras, found)
    return found


PINNED = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if line[:1] != "#")


def test_all_that_the_images_hold_is_pinned(stages: dict[str, list[Instruction]]) -> None:
    assert PINNED.keys() == needed("hedgerow", set(), set())
    installs = [run for run in values(stages["build"], "RUN") if "install" in run]
    assert len(installs) == 2
    assert all("-c constraints.txt" in run for run in installs)


def build(stages: dict[str, list[Instruction]], root: Path) -> dict[str, str]:
    """Run the steps of the build, with `root` in the place of /; return the environment of its programs."""
    for copy in values(stages["build"], "COPY"):
        *sources, target = copy.split()
        for source in sources:
            to = root / "src" / target
            if (ROOT / source).is_dir():
                shutil.copytree(ROOT / source, to, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                to.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / source, to)
    commands = root / "python/bin"
    commands.mkdir(parents=True)
    for name, module in (("python", ""), ("pip", "-m pip ")):
        (commands / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {module}"$@"\n')
        (commands / name).chmod(0o755)
    hidden = ("PYTHONPATH", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    environment["PIP_NO_COMPILE"] = "1"
    environment["PATH"] = f"{commands}{os.pathsep}{os.environ['PATH']}"
    for run in values(stages["build"], "RUN"):
        # Downloads are cached: here in the machine's cache, not in a layer.
        words = re.sub(r"(?<=[ (])/(wheels|opt)\b", rf"{root}/\1", run).replace(" --no-cache-dir", "")
        # The requirements of the orchestrator take minutes, and CI installs them anyway, with the README's first
        # command.
        some = environment | ({"PIP_NO_DEPS": "1"} if "/opt/orchestrator/bin" in run else {})
        done = subprocess.run(
            ["/bin/sh", "-ec", words], cwd=root / "src", env=some, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return environment


@dataclass(frozen=True)
class Image:
    """The files of the built images, and the environment of their programs."""

    root: Path
    environment: dict[str, str]


@pytest.fixture(scope="module")
def image(stages: dict[str, list[Instruction]], tmp_path_factory: pytest.TempPathFactory) -> Image:
    root = tmp_path_factory.mktemp("image")
    return Image(root, build(stages, root))


@pytest.mark.slow
def test_its_wheel_holds_one_package(image: Image) -> None:
    (wheel,) = (image.root / "wheels").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (place,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        shown = archive.read(place).decode()
    assert [link for link in re.findall(r"\]\(([^)]*)\)", shown) if not link.startswith("https://")] == []
    assert {name.split("/")[0].partition("-")[0] for name in names} == {"hedgerow"}
    assert {"hedgerow/topologies/paper7.yaml", "hedgerow/orchestrator/report/report.css"} <= set(names)


@pytest.mark.slow
def test_its_steps_make_an_agent_of_numpy_and_zenoh_and_no_more(here: Path, image: Image) -> None:
    environment = image.environment
    where = {name: image.root / "opt" / name / "bin" for name in ("agent", "orchestrator")}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)

    listed = run(
        str(image.root / "python/bin/pip"), "--python", str(where["agent"] / "python"), "list", "--format=json"
    )
    there = {one["name"]: one["version"] for one in json.loads(listed.stdout)}
    assert there.keys() == {"hedgerow", "eclipse-zenoh", "numpy"}
    assert all(there[name] == PINNED[name] for name in ("eclipse-zenoh", "numpy"))
    assert not (where["agent"] / "pip").exists()

    refused = run(str(where["agent"] / "orchestrator"), "up", "paper7")
    assert refused.returncode == 2
    assert "pip install hedgerow" in refused.stderr, refused.stderr
    assert refused.stderr.count("\n") == 1

    assert (where["orchestrator"] / "orchestrator").exists()

    endpoint = f"unixsock-stream/{here}/lab.sock"
    assert orchestrator("bundle", "paper7", "--out", "lab", "--router", endpoint).returncode == 0
    words = [str(where["agent"] / "hedgerow-agent"), "--name", "3"]
    with (
        subprocess.Popen(words, cwd=here / "lab", env=environment) as agent,
        Orchestrator(
            *("up", "paper7", "--external", "3", "--listen", endpoint, "--viewer", "none", "--no-record")
        ) as network,
    ):
        assert network.wait() == 0, network.output
        assert agent.wait(60) == 0
