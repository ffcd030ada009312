"""The pages of the site, as a browser shows them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("playwright", reason="pip install playwright")

from playwright.sync_api import Page, sync_playwright

CHROMIUM = Path("/usr/bin/chromium")
ROOT = Path(__file__).parents[1]
WIDTHS = (390, 1280)
"""a phone and a laptop [px]"""

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not CHROMIUM.exists(), reason="there is no Chromium here")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    subprocess.run([sys.executable, "-m", "sphinx", "-W", "-q", ROOT / "docs", out], check=True, timeout=180)
    return out


@pytest.fixture(scope="module", params=WIDTHS)
def page(request: pytest.FixtureRequest) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        yield browser.new_page(viewport={"width": request.param, "height": 900})
        browser.close()


def test_no_page_is_wider_than_its_window(site: Path, page: Page) -> None:
    wide = {}
    for file in sorted(site.glob("*.html")):
        page.goto(file.as_uri())
        over = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        if over > 0:
            wide[file.name] = over
    assert wide == {}


def test_every_picture_is_found_and_has_a_text(site: Path, page: Page) -> None:
    for file in sorted(site.glob("*.html")):
        page.goto(file.as_uri())
        pictures = page.evaluate("[...document.images].map(e => [e.src, e.alt, e.naturalWidth])")
        assert [src for src, alt, width in pictures if not (alt and width)] == []


def test_signatures_name_their_types_in_a_word(site: Path) -> None:
    text = (site / "python.html").read_text(encoding="utf-8")
    assert "Annotated" not in text
    assert "pydantic" not in text


def test_a_picture_with_small_text_is_wide_enough_to_be_read(site: Path, page: Page) -> None:
    narrow: dict[str, list[int]] = {}
    for name in ("gallery", "paper", "your-law", "your-network", "faults", "concepts", "watching", "start"):
        page.goto((site / f"{name}.html").as_uri())
        widths = page.evaluate("[...document.querySelectorAll('.content img')].map(e => e.clientWidth)")
        narrow |= {name: widths} if min(widths) < 600 else {}
    assert narrow == {}
