"""A crash that ends with the run, from a file, live and in the fixture; and a full disk while the run is compared."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from hedgerow.orchestrator.testing.scenario import Networks
from tests.tools.processes import COMMAND, DEADLINE_S, orchestrator
from tests.tools.verdicts import verdict_of

UP = ("--viewer", "none", "--no-record", "--verify")


@pytest.mark.parametrize("at", [28, 29])
def test_a_process_with_a_crash_until_the_end_of_the_run(at: int, here: Path) -> None:
    """One of three processes, with several nodes."""
    faults = f"faults=[{{kind: crash, process: 1, at: {at}, restart_after: {30 - at}}}]"
    done = orchestrator("up", "paper7", "--processes", "3", *UP, "--set", faults)
    assert done.returncode == 0, done.stdout + done.stderr
    assert verdict_of()["steps_done"] == 30
    assert verdict_of()["checks"]["reference"]["ok"]


@pytest.mark.parametrize("before", [1, 2])
def test_a_live_crash_that_ends_with_the_run(before: int, network: Networks) -> None:
    with network("paper7").up(rate=50, steps=100) as net:
        net.wait_for_step(5)
        first = net.pause() + 1  # the held step has begun
        net.fault.crash(node=3, at=100 - before - first, restart_after=before)
        net.rate(0)
        net.resume()
        result = net.wait()
    assert result.verdict.verdict == "valid", result.verdict.content["reasons"]
    assert result.x.shape == (101, 7)


def test_a_crash_in_the_fixture_that_ends_with_the_run(network: Networks) -> None:
    scenario = network("paper7").crash(node=3, at=29, restart_after=1)
    with scenario.up(rate=60, steps=30) as net:
        result = net.wait()
    assert result.verdict.verdict == "valid", result.verdict.content["reasons"]
    assert result.x.tobytes() == scenario.run().x.tobytes()


def test_a_kill_in_the_last_steps_is_no_invalid_run(network: Networks) -> None:
    """An agent that dies unplanned while the last steps are made: a crash fault of the run, or after its end."""
    with network("paper7").up(rate=100, steps=60) as net:
        at = net.pause()
        net.wait_for_step(at)
        net.step(57 - at)
        net.wait_for_step(57)
        net.kill("agent-3")
        net.resume()
        result = net.wait()
    assert result.verdict.verdict == "valid", result.verdict.content["reasons"]


def test_a_full_disk_while_the_reference_is_computed(here: Path) -> None:
    """The run itself is elsewhere, and good: it is not compared, and never INVALID."""
    inside = ["unshare", "--map-root-user", "--mount"]
    if subprocess.run([*inside, "true"], capture_output=True, check=False).returncode:
        pytest.skip("needs user namespaces")
    (here / "t").mkdir()
    script = 'mount -t tmpfs -o size=200k none "$TMPDIR" && exec "$@"'
    done = subprocess.run(
        [*inside, "sh", "-c", script, "sh", *COMMAND, "up", "paper7", *UP, "--steps", "3000", "--processes", "1"],
        env=os.environ | {"TMPDIR": str(here / "t"), "XDG_RUNTIME_DIR": str(here)},
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 3, done.stdout + done.stderr
    content = verdict_of()
    assert (content["verdict"], content["steps_done"]) == ("unknown", 3000)
    assert "reference" not in content["checks"]
    assert "not compared" in " ".join(content["reasons"])
    assert "Traceback" not in done.stdout + done.stderr
