"""Words that make a reader stop stay out, and the map of a step in CONTRIBUTING.md names functions that exist.

prose of .py    docstrings, comments, and the texts of messages, helps and descriptions
prose of .md    everything except code, in blocks and between backticks
"""

from __future__ import annotations

import ast
import importlib
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
CODE = ("topologies", "wire", "agents", "plant", "orchestrator", "hedgerow", "benchmarks", "docs", "tests")
ANYWHERE = (
    r"(no|some|any|every)body('s)?|whoever|whosoever|"  # name the process
    r"(is|are|was|were|be|been) (told|said)|"  # receives, reports
    r"so (many|manieth|much so)|every so many|manieth|"  # N, every Nth
    r"(goes?|went|going) on|mend(s|ed|ing)?|for want of|to be had|but for|looks? whether|"
    r"stands? (there|here|in|on|for|beside|behind|twice)|(lies|lay) (beside|there|elsewhere|about)|"
    r"of its own|none of its own|none the wiser|all the same|as it were|in vain|anew|sets? off|c[ao]mes? to harm|"
    r"(row|line|file|process|column|message|number|box|panel|curve)s? an? (node|step|run|process|setting|batch|second)|"
    r"nurser(y|ies)|thereupon|whither|whence|wherefrom|to-be|lest|ere|betwixt|twain|thereof|therein|hither|forthwith"
)
"""Words that decode slowly; the comments name the usual replacement."""
IN_CODE = r"whom|whose|tells?|told|says?|hears?|heard|of (their|one's) own"
"""More such words, for docstrings, comments and messages: a process sends, reports, receives or has."""
RIDDLE = re.compile(r"(What|Who|Whose|Whether|That|How (many|long|often|far)|Of) ")
LONGEST = 45
"""the maximum number of words of a sentence outside of tables, lists and equations"""
FILES = [path for name in CODE for path in sorted((ROOT / name).rglob("*.py")) if path != Path(__file__)]
PAGES = [page for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")] if page.name != "CHANGELOG.md"]


def strings(expression: ast.expr) -> Iterator[str]:
    """Yield the texts in an expression."""
    for node in ast.walk(expression):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


class Prose(NamedTuple):
    """The prose of a Python file, each text with its line."""

    docstrings: list[tuple[int, str]]
    others: list[tuple[int, str]]
    """comments, and the texts of messages, helps and descriptions"""


@cache
def prose(path: Path) -> Prose:
    """Return the prose of a Python file."""
    source = path.read_text(encoding="utf-8")
    found = Prose([], [])
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                found.docstrings.append((node.lineno, text))
            case ast.Raise(exc=ast.Call(args=arguments)):
                found.others.extend((node.lineno, text) for one in arguments for text in strings(one))
            case ast.keyword(arg="help" | "description", value=value):
                found.others.extend((value.lineno, text) for text in strings(value))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    found.others.extend((token.start[0], token.string) for token in tokens if token.type == tokenize.COMMENT)
    return found


def without_code(text: str) -> str:
    """Return a text without the parts between backticks and without code blocks; lines keep their numbers."""
    blank = re.compile(r"^```.*?^```$|`[^`]*`", re.MULTILINE | re.DOTALL)
    return blank.sub(lambda found: "\n" * found[0].count("\n"), text)


def matches(path: Path, line: int, text: str, words: str) -> Iterator[str]:
    """Yield `file:line: word` for each of the words in a text."""
    plain = without_code(text)
    for found in re.finditer(rf"\b({words})\b", plain, re.IGNORECASE):
        yield f"{path.relative_to(ROOT)}:{line + plain[: found.start()].count(chr(10))}: {found[0]}"


def test_the_worst_words_stay_out_of_the_code() -> None:
    words = f"{ANYWHERE}|{IN_CODE}"
    texts = ((path, line, text) for path in FILES for some in prose(path) for line, text in some)
    found = [one for path, line, text in texts for one in matches(path, line, text, words)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_worst_words_stay_out_of_the_documents(page: Path) -> None:
    found = list(matches(page, 1, page.read_text(encoding="utf-8"), ANYWHERE))
    assert not found, "\n".join(found)


def test_no_docstring_starts_with_a_riddle() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text[:80]}"
        for path in FILES
        for line, text in prose(path).docstrings
        if RIDDLE.match(text)
    ]
    assert not found, "\n".join(found)


def test_sentences_of_docstrings_are_short() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {sentence[:120]}"
        for path in FILES
        for line, text in prose(path).docstrings
        for paragraph in re.split(r"\n\s*\n", text)
        if not re.search(r"^ {5,}\S|^\s*[-|]|\S  +\S", paragraph, re.MULTILINE)
        for sentence in re.split(r"(?<=[.!?:;])\s+", re.sub(r"`[^`]*`", "CODE", paragraph))
        if len(sentence.split()) > LONGEST
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text", ["Nobody waits.", "one file, a row a node", "it goes on", "whose row", "what it is told", "tried anew"]
)
def test_the_search_finds_planted_words(text: str) -> None:
    assert list(matches(ROOT / "planted.py", 1, text, f"{ANYWHERE}|{IN_CODE}"))


def named_functions() -> list[tuple[str, str]]:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return [(file, name) for name, file in re.findall(r"\[`(\w+\.\w+)`\]\((\w+/\w+)\.py\)", text)]


@pytest.mark.parametrize(("file", "name"), sorted(set(named_functions())))
def test_the_map_of_a_step_names_functions_that_exist(file: str, name: str) -> None:
    found: object = importlib.import_module("hedgerow." + file.replace("/", "."))
    for part in name.split("."):
        found = getattr(found, part, None)
    assert callable(found)


def test_the_map_of_a_step_is_found() -> None:
    assert len(named_functions()) > 10


def test_the_map_of_a_step_is_short() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    happy = text.split("### When nothing fails")[1].split("###")[0]
    assert 5 <= len(re.findall(r"^\| \d+ \|", happy, re.MULTILINE)) <= 10
