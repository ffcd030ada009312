"""Make docs/images/paper7.gif: a run of paper7 over Zenoh, as the viewer shows it live.

    python docs/animation.py [RATE]

Messages between nodes 2 and 4 are lost at first, and node 2 has a wrong estimate until they arrive late. Then the edge
between 3 and 5 is cut, and the agent of node 4 is killed and comes back. The run is `orchestrator up`, with seven
agent processes; a picture of the viewer is taken per step. Needs a graphics driver, no display: on Debian,
`apt-get install mesa-vulkan-drivers ca-certificates`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from rerun.experimental import ViewerClient

from hedgerow.orchestrator.ground.colours import ON_DARK
from hedgerow.orchestrator.views.palette import DEAD, LOST, NO_INPUT, WRONG, of_hex, packed, state_colors
from hedgerow.orchestrator.views.rerun.viewer import native

STEPS = 64
RATE = 2.5
"""steps per second; a picture takes 0.3 s on two idle cores without a graphics card. On a busy machine, give less."""
FAULTS = [
    {"kind": "drop", "link": [2, 4], "steps": [0, 18]},
    {"kind": "cut", "edge": [3, 5], "steps": [24, 36]},
    {"kind": "crash", "node": 4, "at": 42, "restart_after": 10},
]
SIZE = (1280, 720)
CROP = (0, 36, 1280, 690)
"""the viewer's window without its bars"""
PANEL = (0, 500, 400, 640)
"""the panel *Now*, which is blank on the welcome page"""
WIDTH = 960
EVERY = 2
"""the steps between two frames: a frame takes about 40 kB, because the axes of the panels move"""
FREQUENT = 112
"""the number of frequent colours in the palette"""
FRAME_MS = 220
LAST_MS = 2500
IMAGE = Path(__file__).parent / "images" / "paper7.gif"


def pictures(folder: Path, rate: float) -> list[Image.Image]:
    """Run the network and return the pictures of the viewer in order, without repetitions."""
    viewer = native("--headless", "--window-size", f"{SIZE[0]}x{SIZE[1]}")
    assert viewer.process is not None
    try:
        viewer.wait_until_it_listens()
        client = ViewerClient.connect(viewer.url)
        options = [f"--set=faults={json.dumps(FAULTS)}", f"--steps={STEPS}", f"--rate={rate}", "--no-record"]
        command = [sys.executable, "-m", "hedgerow.orchestrator", "up", "paper7", "--viewer", viewer.url, *options]
        found: list[Image.Image] = []
        client.save_screenshot(str(folder / "frame.png"))
        welcome = Image.open(folder / "frame.png").convert("RGB").crop(CROP).crop(PANEL).tobytes()
        with subprocess.Popen(command, cwd=folder) as up:
            while up.poll() is None:
                began = time.monotonic()
                client.save_screenshot(str(folder / "frame.png"))
                frame = Image.open(folder / "frame.png").convert("RGB").crop(CROP)
                # Before the first step, the viewer shows its own welcome page.
                begun = bool(found) or frame.crop(PANEL).tobytes() != welcome
                if begun and (not found or frame.tobytes() != found[-1].tobytes()):
                    found.append(frame)
                time.sleep(max(0.0, 1 / rate - (time.monotonic() - began)))
        if up.returncode:
            raise SystemExit(f"the run ended with {up.returncode}")
        return found
    finally:
        viewer.process.kill()


def main() -> None:
    """Run, and write the animation."""
    with tempfile.TemporaryDirectory() as folder:
        found = pictures(Path(folder), float(sys.argv[1]) if len(sys.argv) > 1 else RATE)
    frames = [*found[:-1:EVERY], found[-1]]
    height = round(WIDTH * frames[0].height / frames[0].width)
    small = [frame.resize((WIDTH, height), Image.Resampling.LANCZOS) for frame in frames]
    # Use one palette for all frames: otherwise each frame would change the colours of unchanged parts, and the file
    # would grow.
    sheet = Image.new("RGB", (WIDTH, height * 4))
    for k in range(4):
        sheet.paste(small[(k + 1) * len(small) // 5], (0, k * height))
    # Add the colours of nodes, lines and faults: a few pixels of yellow would be drawn in the nearest frequent colour.
    shown = [of_hex(code) for code in ON_DARK] + [WRONG, NO_INPUT, DEAD, LOST]
    packed_colors = [*state_colors(np.linspace(0, 1, 16)), *map(packed, shown)]
    fixed = [int(color) >> shift & 255 for color in packed_colors for shift in (24, 16, 8)]
    palette = sheet.quantize(FREQUENT, kmeans=2)
    palette.putpalette([*(palette.getpalette() or [])[: 3 * FREQUENT], *fixed])
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    times = [FRAME_MS] * (len(drawn) - 1) + [LAST_MS]
    drawn[0].save(IMAGE, save_all=True, append_images=drawn[1:], duration=times, loop=0, optimize=True)
    print(f"{IMAGE}: {len(drawn)} frames, {IMAGE.stat().st_size / 2**20:.1f} MB")


if __name__ == "__main__":
    main()
