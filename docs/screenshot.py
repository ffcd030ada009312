"""Make docs/images/paper7.png and paper7-faults.png: the bundled network paper7 as the viewer shows it.

    python docs/screenshot.py

The first is a run of 60 steps. The second is taken in the middle of a run, while nodes 2 and 4 receive no messages from
each other and the edge between 3 and 5 is cut. Needs a graphics driver, no display: on Debian, `apt-get install
mesa-vulkan-drivers ca-certificates`.
"""

from __future__ import annotations

import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from hedgerow.orchestrator.ground.assignment import layout, truth_of, views_of
from hedgerow.orchestrator.metrics.gain_certificate import GainCertificate
from hedgerow.orchestrator.metrics.guarantee import certified, plant_of
from hedgerow.orchestrator.metrics.observer import Observer
from hedgerow.orchestrator.runs import reference
from hedgerow.orchestrator.views.rerun.stream import RerunStream
from hedgerow.orchestrator.views.rerun.viewer import native
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve
from hedgerow.wire.message import End, Telemetry

STEPS = 60
IMAGES = Path(__file__).parent / "images"
FAULTS = "[{kind: drop, link: [2, 4], steps: [0, 50]}, {kind: cut, edge: [3, 5], steps: [28, 50]}]"
DURING = 40
"""the number of steps shown of the run with faults"""
DEADLINE_S = 60.0
QUIET_S = 8.0


def stream(rerun: RerunStream, observer: Observer, steps: int) -> None:
    """Run the network in this process, and show its first steps."""
    shards = layout(observer.topology, None)
    ran = list(reference.run(truth_of(observer.topology, shards), views_of(observer.topology, shards)))
    rerun.log(observer.take([row for row in ran if isinstance(row, Telemetry)][:steps]))
    if steps < STEPS:
        return
    assert isinstance(ran[-1], End)
    observer.finish(ran[-1])
    rerun.event(f"the run ended after {STEPS} steps", "INFO", STEPS)
    rerun.end(observer)


def settle(client: ViewerClient, image: Path) -> None:
    """Save pictures until none has changed for QUIET_S: the viewer's initial notices have gone by then."""
    now = began = changed = time.monotonic()
    before = b""
    while now < changed + QUIET_S:
        if now > began + DEADLINE_S:
            raise SystemExit("the viewer's picture does not settle")
        client.save_screenshot(str(image))
        picture, now = Image.open(image).tobytes(), time.monotonic()
        if picture != before:
            before, changed = picture, now


def make(image: Path, faults: str, steps: int) -> None:
    """Run, show, and save the picture."""
    observer = Observer(resolve(load("paper7", [f"steps={STEPS}", f"faults={faults}"])))
    network = observer.topology.network
    observer.adaptive = GainCertificate(plant_of(network), observer.x0)
    observer.adaptive.known = certified(plant_of(network), network.gamma_star)
    viewer = native("--headless", "--window-size", "1600x900")
    assert viewer.process is not None
    try:
        rerun = RerunStream(observer.topology, observer, image.stem, None, viewer)
        stream(rerun, observer, steps)
        if not rerun.close(DEADLINE_S):
            raise SystemExit("the viewer does not take the data")
        image.parent.mkdir(exist_ok=True)
        settle(ViewerClient.connect(viewer.url), image)
    finally:
        viewer.process.kill()
    Image.open(image).convert("RGB").quantize(256).save(image, optimize=True)


def main() -> None:
    """Make both pictures."""
    make(IMAGES / "paper7.png", "[]", STEPS)
    make(IMAGES / "paper7-faults.png", FAULTS, DURING)


if __name__ == "__main__":
    main()
