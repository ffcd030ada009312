"""Networks of real processes over real Zenoh: their results, their start and their end."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest

from hedgerow.agents.view import View
from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.launch.fork_client import ForkClient
from hedgerow.orchestrator.launch.options import Options
from hedgerow.orchestrator.launch.up import Network
from hedgerow.orchestrator.launch.watching import Watching
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.errors import Exit
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.session import open_router
from tests.tools.networks import VECTORS, vector_file
from tests.tools.processes import COMMAND, DEADLINE_S, Orchestrator, gone, orchestrator, parquet_bytes

QUIET = ("--viewer", "none", "--no-record")
CHECKS = {
    "dynamics",
    "estimates",
    "contraction",
    "oracle_certificate",
    "missing_inputs",
    "links",
    "faults",
    "plan",
    "law",
    "deaths",
    "information",
    "gain_estimates",
    "gain_edges",
    "gain_jumps",
}
OF_THE_PAPERS_LAW = {"estimates", "contraction", "gain_estimates", "gain_edges", "gain_jumps"}
"""checks that are claimed of laws that act by (6) on the list"""
LONG = ("up", "paper7", "--steps", "1000000", "--rate", "200", *QUIET)


@pytest.fixture
def paper7(here: Path) -> Iterator[Orchestrator]:
    """paper7 running for ever, past its first step."""
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        yield network


def verdict_of(folder: Path) -> dict[str, Any]:
    verdict: dict[str, Any] = json.loads((folder / "verdict.json").read_text())
    return verdict


def shell(words: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a shell, which knows how to close its streams and where to lead them."""
    line = f"{shlex.join(COMMAND)} {words}"
    return subprocess.run(line, shell=True, capture_output=True, text=True, timeout=DEADLINE_S, check=False)


@pytest.mark.parametrize("path", VECTORS, ids=lambda path: path.stem)
def test_the_vectors_hold_with_one_process_a_node(path: Path, here: Path) -> None:
    text, expected = vector_file(path)
    (here / "vector.yaml").write_text(text)
    done = orchestrator("up", "vector.yaml", *QUIET, "--run-dir", "run")
    assert done.returncode == 0, done.stderr
    table = pq.read_table(here / "run" / "telemetry.parquet")
    shape = np.shape(expected["x"])
    x, u, index = (table[name].to_numpy(zero_copy_only=False).reshape(shape) for name in ("x", "u", "index"))
    assert np.abs(x - expected["x"]).max() <= 1e-12
    assert np.abs(u[:-1] - expected["u"]).max() <= 1e-12
    assert (index[:-1] == expected["index"]).all()
    verdict = verdict_of(here / "run")
    assert set(verdict["checks"]) == CHECKS
    assert verdict["metrics"]["gamma_star"] == pytest.approx(expected["gamma_star"], rel=1e-12)
    if "rho" in expected:
        assert verdict["metrics"]["rho"] == pytest.approx(expected["rho"], rel=1e-12)


@pytest.mark.slow
def test_every_layout_over_processes_gives_the_same_bits(here: Path) -> None:
    """paper7 for 1000 steps: simulated, twice with one process per node, in 3 and in 1: five equal pairs of files."""
    runs = {"simulated": ("simulate", "paper7", "--no-record")}
    for name, processes in (("seven", 7), ("seven again", 7), ("three", 3), ("one", 1)):
        runs[name] = ("up", "paper7", *QUIET, "--processes", str(processes))  # type: ignore[assignment]
    for name, arguments in runs.items():
        done = orchestrator(*arguments, "--steps", "1000", "--run-dir", name)
        assert done.returncode == 0, done.stdout + done.stderr
    reference = parquet_bytes(here / "simulated")
    assert all(parquet_bytes(here / name) == reference for name in runs)
    assert pq.read_metadata(here / "seven" / "telemetry.parquet").num_rows == 7 * 1001


def test_a_long_back_fill_causes_no_deadlock(here: Path) -> None:
    """Each side sends a megabyte at once, although the messages are usually short: this exceeds the buffer of a socket.

    Zenoh would close such a session after 5 s.
    """
    groups = [list(range(200)), list(range(200, 400))]
    partition = f"{{kind: partition, groups: {groups}, steps: [100, 600]}}"
    (here / "net.yaml").write_text(
        "{name: net, b: 0.1, steps: 700, graph: {kind: random_regular, nodes: 400, degree: 3, seed: 1},"
        f"defaults: {{x0: 1, candidates: {{random: 3}}}}, faults: [{partition}]}}"
    )
    assert orchestrator("simulate", "net.yaml", "--no-record", "--run-dir", "simulated").returncode == 0
    done = orchestrator("up", "net.yaml", "--processes", "2", *QUIET, "--run-dir", "run")
    assert done.returncode == 0, done.stderr
    assert parquet_bytes(here / "run") == parquet_bytes(here / "simulated")
    assert max(one["max_ms"] for one in verdict_of(here / "run")["round_trips"].values()) < 5000


def test_a_run_leaves_its_folder_and_its_verdict(here: Path) -> None:
    done = orchestrator("up", "paper7", "--viewer", "none", "--verify")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("valid: 30 of 30 steps")
    folder = here / "runs" / "latest"
    left = {path.name for path in folder.iterdir()}
    assert left == {
        "topology.yaml", "telemetry.parquet", "edges.parquet", "summary.parquet", "round_trips.parquet", "run.rrd",
        "events.jsonl", "verdict.json", "logs", "processes",
    }  # fmt: skip
    verdict = verdict_of(folder)
    assert verdict["verdict"] == "valid"
    assert all(check["ok"] for check in verdict["checks"].values())
    assert set(verdict["checks"]) == CHECKS | {"reference"}
    events = [json.loads(line)["event"] for line in (folder / "events.jsonl").read_text().splitlines()]
    assert events == ["start", "first_step", "recording", "verdict"]
    assert f"orchestrator open {folder.resolve()}" in done.stdout
    again = orchestrator("simulate", str(folder), "--run-dir", "again", "--no-record")
    assert again.returncode == 0, again.stderr
    assert parquet_bytes(here / "again") == parquet_bytes(folder)


def test_an_agent_is_a_process_that_knows_its_own_view_only(here: Path, paper7: Orchestrator) -> None:
    """There are eight separate processes. Agent 3 knows its neighbours 2 and 5, and no truth, graph or file."""
    start = json.loads((here / "runs/latest/events.jsonl").read_text().splitlines()[0])
    pids = set(start["pids"].values())
    assert len(pids) == 8
    assert all(Path(f"/proc/{pid}").exists() for pid in pids)
    view = json.loads(View.read(here / "runs/latest/processes/agent-3.json").to_json())
    assert set(view) == {"shard", "b", "law", "nodes", "peers", "history"}
    assert [set(node) for node in view["nodes"]] == [{"id", "candidates", "neighbours"}]
    assert view["nodes"][0]["neighbours"] == [2, 5]
    command = Path(f"/proc/{start['pids']['agent-3']}/cmdline").read_text()
    assert "topology.yaml" not in command
    assert "paper7.yaml" not in command
    mapped = Path(f"/proc/{start['pids']['agent-3']}/maps").read_text()
    assert "/numpy/" in mapped
    assert not any(package in mapped for package in ("/pydantic", "/rerun", "/scipy/", "/pyarrow"))


def test_ctrl_c_ends_cleanly_with_the_recorded_steps(here: Path, paper7: Orchestrator) -> None:
    paper7.send(signal.SIGINT)
    assert paper7.wait() == 3
    assert "Ctrl-C" in paper7.output
    folder = here / "runs/latest"
    verdict = verdict_of(folder)
    assert verdict["verdict"] == "unknown"
    assert pq.read_metadata(folder / "telemetry.parquet").num_rows == 7 * (verdict["steps_done"] + 1)
    assert not list(folder.glob("*.sock*"))
    assert gone(paper7.children)


def test_a_signal_after_the_last_word_changes_nothing(here: Path) -> None:
    """All files are written, and only the end of the processes remains: a signal has no more effect."""
    topology = resolve(load("paper7"), here)
    options, shards = Options(watching=Watching(record=False)), layout(topology, 2)
    heard: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with contextlib.ExitStack() as stack:
            fork_client = stack.enter_context(contextlib.closing(ForkClient()))
            stack.callback(signal.raise_signal, signal.SIGTERM)
            network = Network(topology, create(topology, None), shards, options, Quiet(), fork_client, time.monotonic())
            verdict = network.run(at_last=stack)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert verdict.content["verdict"] == "valid", verdict.content
    assert heard == []


def test_ctrl_c_twice_ends_at_once_even_with_a_frozen_plant(here: Path, paper7: Orchestrator) -> None:
    os.kill(paper7.children["plant"], signal.SIGSTOP)
    paper7.send(signal.SIGINT)
    paper7.wait_for_event("stopping")
    paper7.send(signal.SIGINT)
    assert paper7.wait() == 3
    assert "a second Ctrl-C" in paper7.output
    assert gone(paper7.children)
    assert (here / "runs/latest/telemetry.parquet").exists()


def test_sigkill_of_up_leaves_no_process(here: Path, paper7: Orchestrator) -> None:
    paper7.wait_for("\nstep ")
    children = paper7.children
    paper7.send(signal.SIGKILL)
    assert paper7.wait() == -signal.SIGKILL
    assert gone(children)
    assert {path.name for path in (here / "runs/latest").iterdir()} == {
        "topology.yaml", "telemetry.arrows", "edges.arrows", "summary.arrows", "round_trips.arrows",
        "events.jsonl", "logs", "processes",
    }  # fmt: skip
    assert orchestrator("ps").stdout == "no network is running\n"


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Provide a folder for temporary files of the test, with a path short enough for a socket."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield Path(folder)


def test_a_look_for_networks_removes_the_sockets_of_dead_ones(
    here: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The path of the run's folder is too long for a socket; `up`, its fork server and the plant are killed at once."""
    deep = here / ("d" * 100)
    deep.mkdir()
    monkeypatch.chdir(deep)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        assert gone(network.kill_all_who_could_clean_up())
    assert list(temporary.glob("hedgerow-*/router.sock"))
    assert orchestrator("ps").stdout == "no network is running\n"
    assert not list(temporary.glob("hedgerow-*"))


SHORT = ("up", "paper7", "--steps", "900", "--rate", "300", *QUIET, "--verify")


def repeats_from_its_folder(here: Path) -> bool:
    """Return True if the run's folder, with all changes during the run, gives the same tables again."""
    folder = here / "runs/latest"
    done = orchestrator("simulate", str(folder), "--run-dir", "again", "--no-record")
    assert done.returncode == 0, done.stdout + done.stderr
    return parquet_bytes(here / "again") == parquet_bytes(folder)


def test_a_killed_agent_returns_with_its_knowledge(here: Path) -> None:
    """The trajectory is the same as with a crash in the file, and the estimates continue as without a crash."""
    with Orchestrator(*SHORT) as network:
        network.wait_for("running")
        os.kill(network.children["agent-4"], signal.SIGKILL)
        assert network.wait() == 0, network.output
        assert [network.wait_for_event(kind)["who"] for kind in ("lost", "back")] == ["agent 4"] * 2
        assert gone(network.children)
    assert verdict_of(here / "runs/latest")["restarts"] == 1
    assert repeats_from_its_folder(here)


def test_an_agent_that_dies_repeatedly_stays_down_and_the_run_continues(here: Path) -> None:
    with Orchestrator(*LONG) as network:
        network.wait_for("running")
        network.kill_until_it_stays_down("agent-4")
        step = network.wait_for_event("lost")["step"]
        network.wait_for_step(step + 50)
        network.send(signal.SIGINT)
        assert network.wait() == 3
    assert any("agent-4 was killed by SIGKILL" in reason for reason in verdict_of(here / "runs/latest")["reasons"])


def test_an_agent_that_stays_down_before_the_first_step_ends_the_run_with_its_name(here: Path) -> None:
    """agent-3 was never started, and is not the cause."""
    where = ("--external", "3", "--listen", f"unixsock-stream/{here}/lab.sock")
    with Orchestrator("up", "paper7", *QUIET, *where) as network:
        network.wait_for_event("start")
        network.kill_until_it_stays_down("agent-4")
        assert network.wait() == 3
    assert "agent-4 was killed by SIGKILL" in str(verdict_of(here / "runs/latest")["reasons"])
    assert "agent-3" not in str(verdict_of(here / "runs/latest")["reasons"])


def test_a_network_without_agents_waits_for_them(here: Path) -> None:
    """One process runs all agents: when it dies, the plant does not continue without control."""
    with Orchestrator(*SHORT, "--processes", "1") as network:
        network.wait_for("running")
        os.kill(network.children["shard-0"], signal.SIGKILL)
        assert network.wait() == 0, network.output
        lost, back = (network.wait_for_event(kind) for kind in ("lost", "back"))
    assert back["at"] - lost["step"] <= 2
    assert repeats_from_its_folder(here)


def test_all_agents_killed_at_once_come_back(here: Path) -> None:
    with Orchestrator(*SHORT) as network:
        network.wait_for("running")
        for name, pid in network.children.items():
            if name != "plant":
                os.kill(pid, signal.SIGKILL)
        assert network.wait() == 0, network.output
    assert verdict_of(here / "runs/latest")["restarts"] == 7
    assert repeats_from_its_folder(here)


def test_a_killed_plant_is_named(here: Path, paper7: Orchestrator) -> None:
    os.kill(paper7.children["plant"], signal.SIGKILL)
    assert paper7.wait() == 3
    assert "plant was killed by SIGKILL" in str(verdict_of(here / "runs/latest")["reasons"])
    assert gone(paper7.children)


def test_a_run_continues_without_a_frozen_agent_and_takes_it_back(here: Path) -> None:
    with Orchestrator(*SHORT, "--deadline", "1") as network:
        network.wait_for("running")
        os.kill(network.children["agent-4"], signal.SIGSTOP)
        network.wait_for("no input from agent 4 (alive: yes) for ")
        os.kill(network.children["agent-4"], signal.SIGCONT)
        network.wait_for("agent 4 is back")
        assert network.wait() == 0, network.output
    assert repeats_from_its_folder(here)


def test_a_network_with_silent_agents_ends_with_their_names(here: Path) -> None:
    with Orchestrator(*LONG, "--deadline", "1", "--processes", "2") as network:
        network.wait_for("running")
        assert orchestrator("pause").returncode == 0  # otherwise one of them would be late a step before the other
        for name in ("shard-0", "shard-1"):
            os.kill(network.children[name], signal.SIGSTOP)
        assert orchestrator("resume").returncode == 0
        assert network.wait() == 3
        assert "no input from shard 0 of agents 1, 2, 3, 4 (alive: yes), shard 1 of agents 5, 6, 7" in network.output


def test_two_networks_at_the_same_time_never_meet(here: Path) -> None:
    command = ("up", "paper7", *QUIET, "--verify")
    with Orchestrator(*command) as one, Orchestrator(*command) as other:
        assert one.wait() == 0, one.output
        assert other.wait() == 0, other.output
    folders = sorted(path for path in (here / "runs").iterdir() if not path.is_symlink())
    assert len(folders) == 2
    assert parquet_bytes(folders[0]) == parquet_bytes(folders[1])


def test_two_networks_share_an_existing_router(here: Path) -> None:
    endpoint = f"unixsock-stream/{here / 'shared.sock'}"
    with open_router(endpoint):
        command = ("up", "paper7", *QUIET, "--router", endpoint, "--verify")
        with Orchestrator(*command) as one, Orchestrator(*command) as other:
            assert one.wait() == 0, one.output
            assert other.wait() == 0, other.output


def end(listed: list[dict[str, Any]]) -> None:
    for entry in listed:
        with contextlib.suppress(ProcessLookupError):
            os.kill(entry["pid"], signal.SIGKILL)


def test_ps_status_and_stop_see_a_detached_network(here: Path, request: pytest.FixtureRequest) -> None:
    started = orchestrator(*LONG, "--detach")
    assert started.returncode == 0, started.stdout
    listed = json.loads(orchestrator("ps", "--json").stdout)
    request.addfinalizer(lambda: end(listed))
    assert [entry["folder"] for entry in listed] == [str((here / "runs/latest").resolve())]
    status = json.loads(orchestrator("status", "--json").stdout)
    assert status["steps"] == 1000000
    assert status["step"] > 0
    stopped = orchestrator("stop", listed[0]["run"])
    assert stopped.returncode == 0, stopped.stderr
    assert orchestrator("ps").stdout == "no network is running\n"
    assert gone({"up": listed[0]["pid"]})
    assert "stopped on request" in verdict_of(here / "runs/latest")["reasons"][0]


@pytest.mark.parametrize("given", ["/run/user/of-nobody", "here", "/etc/passwd", ""])
def test_without_a_runtime_folder_networks_are_listed_under_the_temporary_one(
    here: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    (here / "here").mkdir()
    (here / "temporary").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", given)
    monkeypatch.setenv("TMPDIR", str(here / "temporary"))
    assert orchestrator("ps").stdout == "no network is running\n"
    assert [path.name for path in (here / "temporary").iterdir()] == [f"hedgerow-{os.getuid()}"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may write there, it seems")
def test_a_missing_registry_folder_is_reported(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/proc")
    done = orchestrator("ps")
    assert done.returncode == 2
    assert done.stderr.startswith("error: /proc: no place to list running networks: ")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_before_the_first_step_ends_a_detached_run(here: Path, number: int, code: int) -> None:
    with Orchestrator(*LONG, "--detach") as starting:
        starting.wait_for("paper7: 7 nodes")
        command = psutil.Process(starting.pid)
        # The other child relays standard error, with the words of its parent.
        (network,) = [one for one in command.children() if one.cmdline() != command.cmdline()]
        starting.send(number)
        assert starting.wait() == code, starting.output
        assert gone({"up": network.pid})
    assert orchestrator("ps").stdout == "no network is running\n"


@pytest.mark.parametrize(
    "closed", ["<&-", ">&-", "<&- >&- 2>&-"], ids=["standard input", "standard output", "all three"]
)
def test_a_network_runs_with_any_standard_stream_closed(here: Path, closed: str) -> None:
    done = shell(f"up paper7 --viewer none --no-record {closed}")
    assert (done.returncode, done.stderr) == (0, "")
    assert verdict_of(here / "runs/latest")["verdict"] == "valid"


@pytest.mark.parametrize("words", ["ps", "ps --json", "audit paper7", "compose paper7", "simulate paper7 --json"])
def test_an_unwritable_output_is_reported_in_one_line(here: Path, words: str) -> None:
    code = Exit.UNKNOWN if words.startswith("simulate") else Exit.USER_MISTAKE
    done = shell(f"{words} >/dev/full")
    assert done.returncode == code
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert shell(f"{words} >/dev/full 2>&1").returncode == code


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_a_run_continues_with_or_without_its_output(here: Path, command: str) -> None:
    done = shell(f"{command} paper7 --viewer none --no-record >/dev/full")
    assert done.returncode == Exit.UNKNOWN, done.stderr
    assert done.stderr.count("\n") <= 1
    assert verdict_of(here / "runs/latest")["verdict"] == "valid"


LAWS = """
import numpy as np
class Idle:
    def __init__(self, b, candidates): self.k = candidates.shape[1]; self.memory = np.zeros((0, self.k))
    def act(self, x): return np.zeros(self.k)
    def learn(self, x, flow, x_next): pass
    def report(self): return np.full((2, self.k), np.nan)
class Undefined(Idle):
    def act(self, x): return x * np.nan
class Tired(Idle):
    def learn(self, x, flow, x_next): raise RuntimeError("I am tired")
class Late(Idle):
    def act(self, x, now):
        if now.t == 19: raise RuntimeError("I am late")
        return np.zeros(self.k)
class Unstable(Idle):
    def act(self, x): return -180 * x
"""


def test_another_law_comes_in_by_its_name(here: Path) -> None:
    """A law that never acts: x_i is its own disturbed a_i, and no claim of the paper's law is made for it."""
    (here / "laws.py").write_text(LAWS)
    done = orchestrator("up", "paper7", *QUIET, "--law", "laws:Idle", "--verify")
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = verdict_of(here / "runs/latest")
    assert set(verdict["checks"]) == CHECKS - OF_THE_PAPERS_LAW | {"reference"}
    assert pq.read_table(here / "runs/latest/telemetry.parquet")["u"].to_numpy(zero_copy_only=False)[0] == 0.0


@pytest.mark.parametrize("command", ["simulate", "up"])
def test_steps_before_a_failure_of_the_law_are_recorded(here: Path, command: str) -> None:
    (here / "laws.py").write_text(LAWS)
    quiet = QUIET if command == "up" else ["--no-record"]
    done = orchestrator(command, "ring6", *quiet, "--law", "laws:Late", "--set", "processes=1")
    assert done.returncode == 2
    why = verdict_of(here / "runs/latest")["reasons"][0]
    assert why.startswith("stopped at step 19: ")
    assert "law laws:Late: act() of nodes 0, 1, 2, 3, 4, 5 raised RuntimeError: I am late" in why
    run = load_run("runs/latest")
    assert run.T == 19
    assert all(np.isfinite(values).all() for values in (run.x, run.u))


@pytest.mark.parametrize(
    ("law", "code", "named"),
    [
        ("no.such:Law", 2, "law no.such:Law: cannot be loaded"),
        ("laws:Missing", 2, "has no attribute 'Missing'"),
        ("laws:LAWS", 2, "law laws:LAWS"),
        ("laws:Undefined", 2, "nan"),
        ("laws:Tired", 2, "I am tired"),
    ],
)
def test_a_failing_law_is_refused_with_its_reason(here: Path, law: str, code: int, named: str) -> None:
    (here / "laws.py").write_text(LAWS + "LAWS = 3\n")
    for command in (("up", "paper7", *QUIET), ("simulate", "paper7", "--no-record")):
        done = orchestrator(*command, "--law", law)
        assert done.returncode == code
        assert named in done.stdout + done.stderr
        assert "Traceback" not in done.stdout + done.stderr


def test_a_missing_router_is_a_mistake_of_the_user(here: Path) -> None:
    done = orchestrator("up", "paper7", *QUIET, "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 3
    assert "tcp/127.0.0.1:1" in done.stdout + done.stderr


def test_a_run_dir_that_is_in_use_is_refused(here: Path) -> None:
    (here / "full").mkdir()
    (here / "full" / "thesis.tex").write_text("precious")
    done = orchestrator("simulate", "paper7", "--no-record", "--run-dir", "full")
    assert done.returncode == 2
    assert done.stderr.startswith("error: --run-dir full: ")
    assert [path.name for path in (here / "full").iterdir()] == ["thesis.tex"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")
def test_a_full_disk_ends_the_run_with_a_message(here: Path) -> None:
    disk = here / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no file system can be mounted here")
    try:
        done = orchestrator("simulate", "paper7", "--no-record", "--steps", "100000", "--run-dir", str(disk / "run"))
        assert done.returncode == 3
        assert os.strerror(errno.ENOSPC) in done.stdout + done.stderr
        assert "Traceback" not in done.stderr
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_the_agents_program_loads_little(here: Path) -> None:
    code = "import sys, agents.process; print(*sys.modules)"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & {"pydantic", "rerun", "scipy", "pyarrow", "yaml", "rich", "typer", "plant", "orchestrator"}
