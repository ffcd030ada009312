"""A law of the user's own in containers: its files are mounted, and the processes import it from there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

import hedgerow as hg
from hedgerow.orchestrator.deploy.containers import LAW, containers
from hedgerow.orchestrator.deploy.kubernetes import to_kubernetes
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.topologies.errors import Code, UserError
from tests.tools.processes import orchestrator

FILES = {
    "my_laws/__init__.py": "",
    "my_laws/half.py": "import my_gain\nfrom hedgerow.agents.law import Minimax\n\nclass Half(Minimax):\n    pass\n",
    "my_gain.py": "GAIN = 0.5  # of $HOME\n",
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_compose_file_mounts_the_files_of_the_law(here: Path) -> None:
    done = orchestrator("compose", "paper7", "--law", "my_laws.half:Half", "--out", "lab/network.yml")
    assert done.returncode == 0, done.stderr
    made = yaml.safe_load((here / "lab" / "network.yml").read_text())
    for name, service in made["services"].items():
        if name in ("router", "plant"):
            assert "configs" not in service
            continue
        assert service["environment"]["PYTHONPATH"] == LAW
        mounted = {}
        for one in service["configs"]:
            file = here / "lab" / made["configs"][one["source"]]["file"]
            mounted[Path(one["target"]).relative_to(LAW).as_posix()] = file.read_text()
        assert mounted == FILES


def test_manifests_hold_the_files_of_the_law(here: Path) -> None:
    topology = hg.load("paper7", law="my_laws.half:Half")
    one = containers(topology, layout(topology, 7), "n", 10.0, 10**6)
    documents: list[Any] = list(yaml.safe_load_all(to_kubernetes(one)))
    (held,) = [doc for doc in documents if doc["kind"] == "ConfigMap" and doc["metadata"]["name"] == "law"]
    jobs = {doc["metadata"]["name"]: doc["spec"]["template"]["spec"] for doc in documents if doc["kind"] == "Job"}
    assert not any(volume["name"] == "law" for volume in jobs["plant"]["volumes"])
    for name, pod in jobs.items():
        if name != "plant":
            (volume,) = [volume for volume in pod["volumes"] if volume["name"] == "law"]
            items = volume["configMap"]["items"]
            assert {item["path"] for item in items} == set(FILES)
            assert {item["key"] for item in items} == set(held["binaryData"])
            assert {"name": "PYTHONPATH", "value": LAW} in pod["containers"][0]["env"]


def test_a_law_of_the_project_adds_no_files(here: Path) -> None:
    topology = hg.load("paper7", law="notch")
    assert "PYTHONPATH" not in to_kubernetes(containers(topology, layout(topology, 7), "n", 10.0, 10**6))


def test_a_source_too_large_for_a_container_is_refused(here: Path) -> None:
    (here / "large_law.py").write_text(FILES["my_laws/half.py"] + "#" * 600_000)
    topology = hg.load("paper7", law="large_law:Half")
    with pytest.raises(UserError) as refused:
        containers(topology, layout(topology, 7), "n", 10.0, 10**6)
    assert refused.value.code == Code.LAW
