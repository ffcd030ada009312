"""The page of `--viewer web`: in a browser it shows the run while it runs."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hedgerow.orchestrator.views.rerun.panels import lines
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from tests.agents.test_view import Seen
from tests.tools.processes import Orchestrator, orchestrator

pytestmark = [
    pytest.mark.usefixtures("without_display"),
    pytest.mark.filterwarnings("ignore:RRD file has no footer"),  # its writer was ended
]


def test_a_page_on_a_port_that_is_in_use_is_refused_before_the_run_begins() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        page = f"http://127.0.0.1:{other.getsockname()[1]}"
        done = orchestrator("up", "paper7", "--viewer", page)
    assert done.returncode == 2
    assert done.stderr == (
        f"error: --viewer {page}: no page there: Address already in use; choose another port, or an address of ours\n"
    )
    assert not Path("runs").exists()


CHROMIUM = Path("/usr/bin/chromium")
FLAGS = (
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update"
    " --disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist"
)


def drawn(screenshot: Path) -> list[int]:
    """Return the number of pixels in the colour of each node of paper7: zero on a page without a run."""
    pixels = np.asarray(Image.open(screenshot).convert("RGB")).astype(int)
    topology = resolve(load("paper7"))
    (x,) = (quantity for quantity in lines(topology) if quantity.entity == "x")
    return [int((np.abs(pixels - color[:3]).max(axis=2) <= 24).sum()) for color in x.colors]


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM.exists(), reason="there is no Chromium here")
def test_a_page_shows_the_run_while_it_runs(tmp_path: Path) -> None:
    """The link of `up` opens in Chromium: each node's line is drawn, with breaks at lost messages and cuts."""
    api: Any = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    faults = "--set=faults=[{kind: drop, link: [2, 4]}, {kind: cut, edge: [3, 5]}]"
    options = ["--processes", "1", "--steps", "1000000", "--rate", "50", "--viewer", "web", "--no-record", faults]
    with Orchestrator("up", "paper7", *options) as up:
        up.wait_for("watch it at http")
        found = re.search(r"http://\S+", up.output)
        assert found is not None
        with contextlib.ExitStack() as stack:
            playwright = stack.enter_context(api.sync_playwright())
            browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS.split())
            stack.callback(browser.close)
            page = browser.new_page(viewport={"width": 960, "height": 600})
            screenshot = tmp_path / "page.png"

            def look() -> Seen:
                page.screenshot(path=screenshot)
                return Seen(screenshot)

            def until_seen(condition: Callable[[], bool]) -> None:
                by = time.monotonic() + 240.0
                while not condition():
                    assert time.monotonic() < by, drawn(screenshot)
                    page.wait_for_timeout(1000)

            page.goto(f"{found[0]}&renderer=webgl")
            assert page.title() == "Rerun Viewer"
            until_seen(lambda: look().broken and min(drawn(screenshot)) > 60)
            assert page.locator("canvas").count() == 1
            assert "error" not in page.inner_text("body").lower()
        up.send(signal.SIGINT)
        assert up.wait() == 3
