"""Make docs/images/report-*.png: figures of `orchestrator report`, of paper7 and authors7, four to a picture.

python docs/make_report_images.py [FOLDER [PICTURE ...]]
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from hedgerow.orchestrator.ground.assignment import layout
from hedgerow.orchestrator.ground.colours import COLOURS, GREY
from hedgerow.orchestrator.launch.recording import Watching
from hedgerow.orchestrator.launch.simulation import simulate_into
from hedgerow.orchestrator.report.figures import FIGURES
from hedgerow.orchestrator.report.style import look
from hedgerow.orchestrator.runs.folder import create
from hedgerow.orchestrator.runs.reader import load_run
from hedgerow.orchestrator.runs.run import Run
from hedgerow.orchestrator.views.screen import Quiet
from hedgerow.topologies.load import load
from hedgerow.topologies.resolve import resolve

IMAGES = Path(__file__).parent / "images"
PICTURES = {
    "report-paper7": ("paper7", ("paper",)),
    "report-authors7": ("authors7", ("paper",)),
    "report-paper7-ours": ("paper7", ("estimates", "regret", "cost", "gain")),
}
DPI, GAP, SHADES = 180, 24, 7


def ran(name: str, scratch: Path) -> Run:
    """Run a bundled network in this process, and return the run."""
    topology = resolve(load(name))
    folder = create(topology, scratch / name)
    simulate_into(topology, folder, layout(topology, 1), Watching(record=False), Quiet())
    return load_run(folder.path)


def picture(run: Run, keys: tuple[str, ...]) -> Image.Image:
    """Return one figure, or four in two columns."""
    drawn = []
    for kind in FIGURES:
        if kind.key in keys:
            png = io.BytesIO()
            kind.draw([run]).savefig(png, format="png", dpi=DPI)
            drawn.append(Image.open(png).convert("RGB"))
    if len(drawn) == 1:
        return drawn[0]
    columns = drawn[::2], drawn[1::2]
    height = max(sum(one.height for one in column) for column in columns) + GAP
    whole = Image.new("RGB", (2 * drawn[0].width + GAP, height), "white")
    for k, column in enumerate(columns):
        below = 0
        for one in column:
            whole.paste(one, (k * (one.width + GAP), below))
            below += one.height + GAP
    return whole


def palette() -> Image.Image:
    """Return the colours of the figures in shades up to white: a palette of the picture's own would merge two hues."""
    codes = [bytes.fromhex(code[1:]) for code in (*COLOURS, GREY)]
    shades = [round(255 + (part - 255) * k / SHADES) for code in codes for k in range(1, SHADES + 1) for part in code]
    sheet = Image.new("P", (1, 1))
    sheet.putpalette([255, 255, 255, *shades])
    return sheet


def numbers(run: Run) -> str:
    """Return the numbers behind a picture, to detect an outdated one."""
    metrics = run.verdict.content["metrics"]
    text = f"{run.topology.name}: D {metrics['regret']:.6g}, nominal {metrics['regret_nominal']:.6g}"
    return text + f", gain {metrics['gain']:.6g}, {metrics['nodes_right']} right"


def main(images: Path, pictures: Sequence[str]) -> None:
    """Draw and write the pictures, and print their numbers."""
    with tempfile.TemporaryDirectory() as scratch, look():
        runs = {name: ran(name, Path(scratch)) for name in sorted({PICTURES[file][0] for file in pictures})}
        for file in pictures:
            name, keys = PICTURES[file]
            info = PngInfo()
            info.add_text("Description", numbers(runs[name]))
            small = picture(runs[name], keys).quantize(palette=palette(), dither=Image.Dither.NONE)
            small.save(images / f"{file}.png", optimize=True, pnginfo=info)
            print(f"{file}.png: {numbers(runs[name])}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES, sys.argv[2:] or [*PICTURES])
