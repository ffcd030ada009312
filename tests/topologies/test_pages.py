"""Messages name pages by the address of the site: an installed package has no docs folder."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from email.message import Message
from importlib import metadata
from pathlib import Path

import pytest

from hedgerow.topologies import pages
from tests.tools.documents import ROOT

SITE = "https://example.org/hedgerow"


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    pages.site.cache_clear()
    yield
    pages.site.cache_clear()


@pytest.mark.parametrize("name", pages.TITLES)
def test_a_page_exists_and_has_its_heading(name: str) -> None:
    assert (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8").splitlines()[0] == f"# {pages.TITLES[name]}"


def test_a_release_with_a_site_gives_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    urls = Message()
    urls["Project-URL"] = "Paper, https://arxiv.org/abs/2210.00081"
    urls["Project-URL"] = f"Documentation, {SITE}/"
    monkeypatch.setattr(metadata, "metadata", lambda _: urls)
    assert pages.page("laws") == f"{SITE}/laws.html"


def test_a_copy_without_metadata_gives_the_title(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "metadata", missing)
    assert pages.TITLES["laws"] in pages.page("laws")


def _texts(file: Path) -> Iterator[ast.Constant]:
    """The strings of a module that are not docstrings."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    free = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in free:
            yield node


def test_no_message_names_a_file_of_the_docs_folder() -> None:
    found = [
        f"{file.relative_to(ROOT)}:{text.lineno}"
        for folder in ("topologies", "wire", "agents", "plant", "orchestrator")
        for file in sorted((ROOT / folder).rglob("*.py"))
        for text in _texts(file)
        if "docs/" in str(text.value)
    ]
    assert not found
