"""The documents show what the code does: their commands and programs are run, and their links lead somewhere.

In a fenced block of README.md or docs/*.md

    ```console          each line `$ orchestrator …` is run, and must exit with 0, or with what `# exit 2` behind it
                        claims; what is shown below it must be what it prints, `...` standing for anything;
                        lines with `# not run`, and other commands, are passed over
    ```python           is run, and must exit with 0; a ```text block right behind it is what it must print
    ```python NAME      the same, kept as a file of that name
    ```yaml NAME        is kept as a file of that name (and so with any other language)

The blocks of one document share a scratch folder, and run in its order.
"""

from __future__ import annotations

import json
import re
import runpy
import subprocess
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.tools import preloaded
from tests.tools.documents import DOCS, ROOT, Block, Scratch, blocks, commands, follows, same_output

SLOW = {
    "README.md",
    "data.md",
    "faults.md",
    "guarantee.md",
    "import.md",
    "laws.md",
    "live-faults.md",
    "machines.md",
    "paper.md",
    "report.md",
    "run-folder.md",
    "security.md",
    "theory.md",
    "watching.md",
    "your-law.md",
    "your-network.md",
    "zoo.md",
}
"""Documents with blocks that take more than five seconds."""
GENERATED = "topology.md"
"""docs/generate.py runs its commands and writes their output: test_topology_md_is_fresh."""


def document_parameters() -> list[Any]:
    return [pytest.param(path, id=path.name, marks=[pytest.mark.slow] if path.name in SLOW else []) for path in DOCS]


@pytest.mark.parametrize("document", document_parameters())
def test_a_document_shows_the_real_output(document: Path, tmp_path: Path) -> None:
    """Every command exits as claimed, every program runs, and their outputs equal those on the page."""
    scratch = Scratch(tmp_path)
    if document.name != "README.md":  # its commands start the installed program
        scratch.preload()
    program: tuple[Block, str] | None = None
    for block in blocks(document):
        where = f"{document.name}:{block.line}"
        if block.name:
            (tmp_path / block.name).write_text(block.text, encoding="utf-8")
        match block.language:
            case "python":
                name = block.name or "block.py"
                (tmp_path / name).write_text(block.text, encoding="utf-8")
                code, printed = scratch.run(*scratch.python, name)
                assert code == 0, f"{where}: exit code {code}\n{printed}"
                program = (block, printed)
            case "text" if program is not None and follows(program[0], block):
                assert same_output(block.text, program[1]), f"{where}: printed is\n{program[1]}"
            case "console" if document.name != GENERATED:
                for command, claimed, shown in commands(block.text):
                    code, printed = scratch.run_command(command)
                    assert code == claimed, f"{where}: `{command}`: exit code {code}, not {claimed}\n{printed}"
                    shows = not shown.strip() or same_output(shown, printed)
                    assert shows, f"{where}: `{command}` prints\n{printed}"
    if any(block.language in ("python", "console") for block in blocks(document)):
        code, running = scratch.run("orchestrator", "ps", "--json")
        assert (code, json.loads(running)) == (0, [])


def test_there_is_something_to_run() -> None:
    """An unrecognised fence would make the test above pass."""
    shown = [(block.language, *commands(block.text)) for path in DOCS for block in blocks(path)]
    assert sum(language == "console" and bool(rest) for language, *rest in shown) > 10
    assert sum(language == "python" for language, *_ in shown) > 5


def test_every_example_is_in_a_document() -> None:
    """A block with the name of a file in docs/examples is that file, and no file there is shown nowhere."""
    shown = {block.name: block.text for path in DOCS for block in blocks(path) if block.name}
    examples = {
        path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs/examples").iterdir() if path.is_file()
    }
    assert {name: shown.get(name) for name in examples} == examples


def test_topology_md_is_fresh() -> None:
    """docs/topology.md is the output of docs/generate.py."""
    page = runpy.run_path(str(ROOT / "docs/generate.py"))
    fresh = page["generate"]([str(preloaded.SESSION.programs / "orchestrator")])
    assert page["RESULT"].read_text(encoding="utf-8") == fresh


def test_the_picture_of_faults_is_fresh(tmp_path: Path) -> None:
    """docs/plot_faults.py draws, and the picture in docs/faults.md has the same numbers."""
    image = tmp_path / "faults.png"
    ran = subprocess.run(
        [str(preloaded.SESSION.programs / "program"), str(ROOT / "docs/plot_faults.py"), str(image)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout
    with Image.open(ROOT / "docs/images/faults.png") as old, Image.open(image) as new:
        assert old.info["Description"] == new.info["Description"] == ran.stdout.strip()
        assert old.size == new.size
        assert len(new.convert("RGB").getcolors(new.width * new.height) or ()) > 100  # something was drawn


def test_links_lead_somewhere() -> None:
    """Every relative link names a file that exists, and a heading in it."""
    wrong = []
    for document in DOCS:
        text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"[a-z]+:", target):
                continue
            file, _, heading = target.partition("#")
            path = (document.parent / file).resolve() if file else document
            if not path.exists() or (heading and heading not in headings(path)):
                wrong.append(f"{document.name}: {target}")
    assert wrong == []


def headings(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
