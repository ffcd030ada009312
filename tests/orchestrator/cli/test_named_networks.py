"""Which running network a live command acts on: never a silent choice among several."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from hedgerow.orchestrator.launch.live import Live
from hedgerow.orchestrator.runs import registry
from hedgerow.topologies.errors import Code, Exit, UserError
from tests.tools.processes import run_here


@pytest.fixture
def listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[contextlib.ExitStack]:
    """A registry of this test's own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with contextlib.ExitStack() as stack:
        yield stack


def announce(stack: contextlib.ExitStack, monkeypatch: pytest.MonkeyPatch, run: str, directory: Path) -> None:
    """List a network as if it had been started in `directory`."""
    directory.mkdir(parents=True, exist_ok=True)
    monkeypatch.chdir(directory)
    stack.enter_context(registry.announced(run, directory / "runs" / run, "unix/x", f"hedgerow/{run}"))


def refused(run: str | None) -> UserError:
    with pytest.raises(UserError) as caught:
        registry.find(run)
    return caught.value


def test_without_a_network_there_is_none_to_name(listed: contextlib.ExitStack) -> None:
    assert refused(None).code == Code.NETWORK_MISSING
    assert refused("pair-1").code == Code.NETWORK_MISSING


def test_the_only_network_is_meant_from_every_folder(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path / "a")
    monkeypatch.chdir(tmp_path)
    assert registry.find(None).run == "pair-1"
    assert refused("ring").code == Code.NETWORK_MISSING


def test_of_several_networks_that_of_this_folder_is_meant(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path / "a")
    announce(listed, monkeypatch, "pair-2", tmp_path / "b")
    for folder, run in (("a", "pair-1"), ("b", "pair-2")):
        monkeypatch.chdir(tmp_path / folder)
        assert registry.find(None).run == run
        assert registry.find("pair").run == run, "the beginning of both names"
    (tmp_path / "link").symlink_to(tmp_path / "a")
    monkeypatch.chdir(tmp_path / "link")
    assert registry.find(None).run == "pair-1"


def test_several_networks_that_are_not_of_this_folder_are_listed(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path / "a")
    announce(listed, monkeypatch, "pair-2", tmp_path / "b")
    monkeypatch.chdir(tmp_path)
    for run in (None, "pair"):
        error = refused(run)
        assert error.code == Code.NETWORK_AMBIGUOUS
        assert all(name in str(error) for name in ("pair-1", "pair-2"))
    assert registry.find("pair-1").run == "pair-1", "a whole name means one"
    assert registry.find("a/runs/pair-1").run == "pair-1", "and so does its folder"


def test_two_networks_of_one_folder_are_listed_there_too(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path / "a")
    announce(listed, monkeypatch, "pair-2", tmp_path / "a")
    announce(listed, monkeypatch, "ring-1", tmp_path / "b")
    monkeypatch.chdir(tmp_path / "a")
    error = refused(None)
    assert error.code == Code.NETWORK_AMBIGUOUS
    assert "ring-1" not in str(error), "it is not of this folder"
    assert registry.find("ring").run == "ring-1", "a name leads out of the folder"


def test_two_networks_of_one_name_are_distinguished_by_their_folders(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [tmp_path / "a" / "bench", tmp_path / "b" / "bench"]
    for folder in folders:
        announce(listed, monkeypatch, "pair-1", folder)
        entry = registry.entry_path("pair-1")
        entry.rename(entry.with_name(f"{folder.parent.name}.json"))  # as of two processes
    monkeypatch.chdir(tmp_path)
    error = refused("pair-1")
    assert error.code == Code.NETWORK_AMBIGUOUS
    for folder in folders:
        run = str(folder / "runs/pair-1")
        assert run in str(error)
        assert registry.find(run).folder == run


def test_an_entry_of_an_older_release_is_still_found(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(listed, monkeypatch, "pair-1", tmp_path / "a")
    entry = registry.entry_path("pair-1")
    content = json.loads(entry.read_text(encoding="utf-8"))
    del content["directory"]
    entry.write_text(json.dumps(content), encoding="utf-8")
    assert registry.find(None).run == "pair-1"


def test_a_run_that_is_over_and_keeps_its_page_is_no_running_network(
    listed: contextlib.ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its plant has ended: a request would wait 10 s for a router that has ended too."""
    announce(listed, monkeypatch, "pair-1", tmp_path)
    folder = tmp_path / "runs" / "pair-1"
    assert not registry.find(None).is_over
    folder.mkdir(parents=True)
    (folder / "verdict.json").write_text('{"verdict": "INVALID"}')
    for words in (("status",), ("pause", "pair-1"), ("watch", "pair-1"), ("fault", "list", "--run", "pair-1")):
        done = run_here(*words)
        assert done.returncode == Exit.USER_MISTAKE
        assert "orchestrator open" in done.stderr
        assert "INVALID" in done.stderr
    with pytest.raises(UserError) as caught, Live("pair-1"):
        pass
    assert caught.value.code == Code.NETWORK_MISSING
    assert "INVALID" in run_here("ps").stdout
    listed_now = json.loads(run_here("ps", "--json").stdout)
    assert [(entry["over"], entry["verdict"]) for entry in listed_now] == [(True, "INVALID")]
    (folder / "verdict.json").write_text("{")  # a file that is damaged hides no run
    assert [entry["verdict"] for entry in json.loads(run_here("ps", "--json").stdout)] == [None]
    announce(listed, monkeypatch, "pair-2", tmp_path)
    assert registry.find(None).run == "pair-2"
