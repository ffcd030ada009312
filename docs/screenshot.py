"""Make docs/images/paper7.png: the bundled network paper7 over 60 steps, as the viewer shows it.

    python docs/screenshot.py

Needs a graphics driver, no display: on Debian, `apt-get install mesa-vulkan-drivers ca-certificates`.
"""

from __future__ import annotations

import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from orchestrator import in_process
from orchestrator.assign import layout, truth_of, views_of
from orchestrator.observe import Observer
from orchestrator.rerun_stream import RerunStream
from orchestrator.viewer import native
from topologies.load import load
from topologies.resolve import resolve
from wire.codec import End, Telemetry

STEPS = 60
IMAGE = Path(__file__).parent / "images" / "paper7.png"
DEADLINE_S = 60.0
QUIET_S = 8.0


def stream(rerun: RerunStream, observer: Observer) -> None:
    """Run the network in this process, and show it."""
    shards = layout(observer.topology, None)
    ran = list(in_process.run(truth_of(observer.topology, shards), views_of(observer.topology, shards)))
    rerun.log(observer.take([row for row in ran if isinstance(row, Telemetry)]))
    assert isinstance(ran[-1], End)
    observer.finish(ran[-1])
    rerun.event(f"the run ended after {STEPS} steps", "INFO", STEPS)
    rerun.end(observer)


def settle(client: ViewerClient) -> None:
    """Save pictures until none has changed for QUIET_S: the viewer's notices at its start have gone by then."""
    now = began = changed = time.monotonic()
    before = b""
    while now < changed + QUIET_S:
        if now > began + DEADLINE_S:
            raise SystemExit("the viewer's picture does not settle")
        client.save_screenshot(str(IMAGE))
        picture, now = Image.open(IMAGE).tobytes(), time.monotonic()
        if picture != before:
            before, changed = picture, now


def main() -> None:
    """Run, show, and save the picture."""
    observer = Observer(resolve(load("paper7", [f"steps={STEPS}"])))
    viewer = native("--headless", "--window-size", "1600x900")
    assert viewer.process is not None
    rerun = RerunStream(observer.topology, observer, "paper7", None, viewer)
    try:
        stream(rerun, observer)
        if not rerun.close(DEADLINE_S):
            raise SystemExit("the viewer does not take the data")
        IMAGE.parent.mkdir(exist_ok=True)
        settle(ViewerClient.connect(viewer.url))
    finally:
        viewer.process.kill()
    Image.open(IMAGE).convert("RGB").quantize(128).save(IMAGE, optimize=True)


if __name__ == "__main__":
    main()
