"""The link of a page answers when `up` prints it, with piped output too."""

from __future__ import annotations

import re
import signal
import urllib.request
from pathlib import Path

import pytest

from tests.tools.processes import Orchestrator


def test_the_link_answers_when_it_is_printed_and_not_after_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--processes=1", "--steps=1000000", "--rate=50", "--viewer=web", "--no-record"]
    with Orchestrator("up", "paper7", *options) as up:
        up.wait_for("watch it at http")
        (link,) = re.findall(r"http://\S+", up.output)
        with urllib.request.urlopen(link, timeout=5) as page:
            assert page.status == 200
        up.send(signal.SIGINT)
        assert up.wait() == 3
    with pytest.raises(OSError):
        urllib.request.urlopen(link, timeout=5)
