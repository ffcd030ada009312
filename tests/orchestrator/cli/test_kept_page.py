"""The page of a run that stays after the run, also if the output goes into a pipe."""

from __future__ import annotations

import re
import signal
import urllib.request
from pathlib import Path

import pytest

from tests.tools.processes import Orchestrator, orchestrator


@pytest.mark.slow
def test_a_page_stays_until_ctrl_c_if_up_is_asked_to_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with Orchestrator("up", "paper7", "--viewer=web", "--keep", "--no-record") as up:
        up.wait_for("valid: 30 of 30 steps")
        up.wait_for("stays until Ctrl-C")
        link = re.findall(r"http://\S+", up.output)[-1]
        with urllib.request.urlopen(link, timeout=60) as page:
            assert page.status == 200
        assert orchestrator("status").returncode == 2  # there is no plant to wait for
        up.send(signal.SIGINT)
        assert up.wait() == 0


def test_nothing_is_kept_without_a_page() -> None:
    refused = orchestrator("up", "paper7", "--viewer=none", "--keep")
    assert refused.returncode == 2
    assert "--keep" in refused.stdout + refused.stderr
