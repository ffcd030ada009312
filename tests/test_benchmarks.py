"""The loops beside ours: a hand-written one makes our trajectory to the bit, and the one command runs them.

Large peers are not installed where the tests run: the suite names them, and continues.
"""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from benchmarks.peers import PEERS
from benchmarks.peers.network import Agent, Lockstep, Plant
from benchmarks.suite import Round, medians, network_of, reference, table

HAND_WRITTEN = ("numpy", "datagrams", "pyzmq")


def suite(*options: str, **settings: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks.suite", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=os.environ | settings)


def test_the_minds_of_the_peers_make_our_trajectory_however_messages_are_ordered(tmp_path: Path) -> None:
    network = network_of(7, tmp_path)
    steps = 8
    x, u = reference(network, steps)
    plant = Plant(network, steps)
    agents = [Agent(network, i) for i in range(7)]
    ends = [Lockstep(agent) for agent in agents]
    links: list[tuple[int, tuple[int, int, float, float]]] = []
    for t in range(steps):
        printed = {}
        states = [(i, (-1, t, plant.x[i], 0.0)) for i in range(7)]
        # Odd steps: messages of t - 1 come after the states of t; even steps: before them.
        for i, message in states + links if t % 2 else links + states:
            if (now := ends[i].take(*message)) is not None:
                printed[i] = now
        assert {now[0] for now in printed.values()} == {t}
        links = [(j, (i, *now)) for i, now in printed.items() for j in agents[i].neighbours]
        assert plant.x.tobytes() == x[t].tobytes()
        plant.step([printed[i][2] for i in range(7)])
        assert [printed[i][2] for i in range(7)] == u[t].tolist()


def test_one_command_runs_the_hand_written_loops_bit_for_bit_and_saves_the_results(tmp_path: Path) -> None:
    if importlib.util.find_spec("zmq") is None:
        pytest.skip("pyzmq is not installed")
    plot = tmp_path / "plot.svg"
    done = suite(
        *("--quick", "--only", ",".join(HAND_WRITTEN), "--nodes", "7"),
        *("--results", str(tmp_path), "--plot", str(plot)),
    )
    assert done.returncode == 0, done.stderr
    for name in HAND_WRITTEN:
        (line,) = [line for line in done.stdout.splitlines() if line.startswith(f"| {PEERS[name].title} ")]
        assert line.endswith("| yes |")
    (file,) = tmp_path.glob("*.json")
    rounds = json.loads(file.read_text())["rounds"]
    assert [one["peer"] for one in rounds] == list(HAND_WRITTEN)
    assert all(one["equal"] and one["steps_per_s"] > 0 and one["pss_mb"] > 0 for one in rounds)
    assert "<svg" in plot.read_text()
    assert suite("--from", str(file)).stdout == done.stdout


def test_a_peer_that_is_not_installed_is_passed_over_by_name() -> None:
    if PEERS["helics"].installed:
        pytest.skip("HELICS is installed")
    done = suite("--quick", "--only", "numpy,helics", "--nodes", "7")
    assert done.returncode == 0, done.stderr
    assert "helics: " in done.stdout


def test_a_peer_that_does_not_exist_is_a_mistake_with_a_cure() -> None:
    done = suite("--only", "carrier-pigeons")
    assert done.returncode == 1
    assert "carrier-pigeons: " in done.stderr
    assert "numpy, datagrams" in done.stderr, "it lists the peers"


def test_an_interrupted_suite_leaves_no_process(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.suite", "--only", "numpy,datagrams", "--rounds", "1000"]
    with subprocess.Popen(
        [*command, "--nodes", "7", "--results", str(tmp_path)], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        next(line for line in process.stderr if "numpy" in line)
        below: list[psutil.Process] = []
        while len(below) < 8:  # the loop's plant and its seven agents
            below = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        process.stderr.read()
    assert not [one for one in below if one.is_running()]
    assert not list(tmp_path.iterdir())


def test_ratios_are_to_the_loop_of_the_same_round() -> None:
    rates = {"pyzmq": (100.0, 50.0, 10.0), "ours": (50.0, 50.0, 2.0)}
    rounds = [
        Round(peer, 7, number, 10, rate, 1.0, 10.0, True)
        for peer, each in rates.items()
        for number, rate in enumerate(each)
    ]
    pyzmq, ours = medians(rounds)
    assert (pyzmq.ratio, ours.ratio, ours.steps_per_s) == (1.0, 0.5, 50.0)


def test_a_different_trajectory_and_a_failure_are_reported() -> None:
    rounds = [
        Round("datagrams", 7, 0, 10, 100.0, 1.0, 10.0, equal=False, off_by=0.5),
        Round("datagrams", 20, 0, 10, failure="TimeoutExpired"),
    ]
    printed = table(medians(rounds), [rounds[1]], ["ray"])
    assert "| NO |" in printed
    assert "TimeoutExpired" in printed
    assert "ray: " in printed
