"""Text of others on the way to a screen: ids, tags, file names, column names and keys act on no terminal."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from hedgerow.orchestrator.cli.exit_code import run_to_exit_code
from hedgerow.orchestrator.cli.main import app
from hedgerow.orchestrator.views.outlet import left_behind
from tests.tools.processes import COMMAND, DEADLINE_S

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b2J\u202e\x7f"
WRITTEN = r"\e]0;owned\a\e[2J\N2J\u202e\x7f".replace(r"\N", r"\x9b")
"""the same in a YAML text in double quotes"""
HEAD = "name: n\nb: 0.1\nsteps: 3\nseed: 1\nedges: [[p, q]]\n"
FILES = {
    "id": HEAD + f'nodes: [p, q, "{WRITTEN}"]\n',
    "key": HEAD + f'nodes: [p, q]\n"{WRITTEN}": 1\n',
    "key of a node": HEAD + f'nodes: {{p: {{"{WRITTEN}": 1}}, q: {{}}}}\n',
    "tag": HEAD + "nodes: !x%1b%5b2J%c2%9b2J [p, q]\n",
    "anchor": HEAD + "nodes: *x\x1b[2J\n",
    "law": HEAD + f'nodes: [p, q]\nlaw: "{WRITTEN}:Law"\n',
    "name": HEAD.replace("name: n", f'name: "{WRITTEN}"') + "nodes: [p, q]\n",
    "file": HEAD + f'nodes: [p, q]\ndefaults: {{disturbance: {{kind: samples, file: "{WRITTEN}.csv"}}}}\n',
    "column": HEAD + "nodes: {p: {}, q: {}}\ndefaults: {disturbance: {kind: samples, file: w.csv}}\n",
    "table": HEAD + f'table: "{WRITTEN}.npz"\n',
    "fault": HEAD + f'nodes: [p, q]\nfaults: [{{kind: "{WRITTEN}"}}]\n',
}
CONTROLS = {*range(0x20), *range(0x7F, 0xA0), 0x202E} - {0x0A}


def assert_harmless(*outputs: str) -> None:
    for output in outputs:
        assert not {ord(one) for one in output} & CONTROLS


def run(*words: str) -> int:
    return run_to_exit_code(lambda: app(list(words), standalone_mode=False) or 0)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", ["check", "simulate"])
@pytest.mark.parametrize("case", FILES)
def test_a_topology_of_others(here: Path, capsys: pytest.CaptureFixture[str], case: str, command: str) -> None:
    (here / "n.yaml").write_text(FILES[case], encoding="utf-8")
    (here / "w.csv").write_text(f"p,q{HOSTILE}\n1,2\n1,2\n1,2\n", encoding="utf-8")
    assert run(command, "n.yaml", "--no-record" if command == "simulate" else "--import-law") == 2
    printed = capsys.readouterr()
    assert printed.err
    assert_harmless(printed.out, printed.err)


@pytest.mark.parametrize(
    "words",
    [
        ("check", HOSTILE),
        ("check", "paper7", "--set", HOSTILE),
        ("check", "paper7", "--set", f"nodes.{HOSTILE}.x0=1"),
        ("check", "paper7", "--set", f"name={HOSTILE}"),
        ("check", "paper7", f"--{HOSTILE}"),
        ("check", "paper7", "--law", HOSTILE),
        ("simulate", "paper7", "--viewer", HOSTILE),
        ("export", HOSTILE, "--to", "csv"),
        ("export", HOSTILE, "--to", HOSTILE),
        ("status", HOSTILE),
        (HOSTILE,),
    ],
    ids=str,
)
def test_words_of_a_command(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    assert run(*words) == 2
    printed = capsys.readouterr()
    assert printed.err
    assert_harmless(printed.out, printed.err)


def test_a_hostile_folder_and_verdict(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = here / HOSTILE
    assert run("simulate", "paper7", "--steps", "3", "--no-record", "--run-dir", str(folder)) == 0
    verdict = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    changed = {**verdict, HOSTILE: 1, "run": HOSTILE, "reasons": [HOSTILE], "verdict": HOSTILE}
    (folder / "verdict.json").write_text(json.dumps(changed), encoding="utf-8")
    run("export", str(folder), "--to", "csv", "--out", str(here / f"out{HOSTILE}"))
    run("export", str(folder), "--to", "csv", "--out", str(here / f"out{HOSTILE}"))
    printed = capsys.readouterr()
    assert_harmless(printed.out, printed.err)


def test_a_processs_own_streams(here: Path) -> None:
    """Standard output and standard error of real processes, to the byte."""
    simulated = ("simulate", "paper7", "--steps", "3", "--no-record", "--json", "--run-dir", HOSTILE)
    commands: list[tuple[str, ...]] = [(*COMMAND, *simulated)]
    commands += [(sys.executable, "-P", "-m", f"hedgerow.{name}", f"--{HOSTILE}") for name in ("agents", "plant")]
    for command, code in zip(commands, (0, 2, 2), strict=True):
        done = subprocess.run(command, capture_output=True, check=False, timeout=DEADLINE_S, cwd=here)
        assert done.returncode == code
        assert_harmless(done.stdout.decode(), done.stderr.decode())
        if code == 0:
            assert json.loads(done.stdout)["folder"].endswith(HOSTILE)


@pytest.mark.parametrize("name", ["a b", "a;b", "$(a)", "a'b", "#a", "~a", "`a`"])
def test_commands_for_copy_and_paste(here: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """The command that a run prints at its end opens that run, and the README of a bundle has the namespace whole."""
    assert shlex.split(left_behind(here / name).splitlines()[1].partition(": ")[2])[1:3] == ["open", str(here / name)]
    namespace = name.replace("#", "+").replace("$", "+")
    assert run("bundle", "paper7", "--out", str(here / name), "--router", "tcp/h:7447", "--namespace", namespace) == 0
    readme = (here / name / "README.md").read_text(encoding="utf-8")
    noted = next(line for line in readme.splitlines() if "--namespace" in line)
    assert shlex.split(noted)[-1] == namespace
    assert str(here / name) in capsys.readouterr().out
