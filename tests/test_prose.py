"""Words that make a reader stop stay out, and the map of a step in CONTRIBUTING.md names functions that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("topologies", "wire", "agents", "plant", "orchestrator", "docs")
WORST = re.compile(
    r"\b(so manieth|manieth|nurser(y|ies)|whoever|thereupon|whither|whence|wherefrom|to-be|"
    r"every so often|as it were|none the wiser|nobody the wiser|lest|ere|betwixt|twain)\b",
    re.IGNORECASE,
)
FILES = (path for name in FOLDERS for end in ("py", "md") for path in (ROOT / name).rglob(f"*.{end}"))
TEXTS = [*ROOT.glob("*.md"), *FILES]


def test_the_worst_words_stay_out() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {match[0]}"
        for path in TEXTS
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (match := WORST.search(line))
    ]
    assert not found, "\n".join(found)


def named_functions() -> list[tuple[str, str]]:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return re.findall(r"\]\((\w+/\w+)\.py\) `(\w+(?:\.\w+)?)`", text)


@pytest.mark.parametrize(("file", "name"), sorted(set(named_functions())))
def test_the_map_of_a_step_names_functions_that_exist(file: str, name: str) -> None:
    found: object = importlib.import_module("hedgerow." + file.replace("/", "."))
    for part in name.split("."):
        found = getattr(found, part, None)
    assert callable(found)


def test_the_map_of_a_step_is_short() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    happy = text.split("### When nothing fails")[1].split("###")[0]
    assert 5 <= len(re.findall(r"^\| \d+ \|", happy, re.MULTILINE)) <= 10
