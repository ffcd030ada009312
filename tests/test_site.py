"""The settings of the site: a reader copies commands without the marks of our tests."""

from __future__ import annotations

import runpy
from typing import Any

import pytest

from tests.tools.documents import ROOT

pytest.importorskip("sphinx")


@pytest.mark.parametrize(
    ("written", "shown"),
    [
        ("$ python -m benchmarks.shards  # not run\nfast\n", "$ python -m benchmarks.shards\nfast\n"),
        ("$ a --seeds 0:100  # not run by the tests\n", "$ a --seeds 0:100\n"),
        ("$ a wrong.yaml  # exit 2\n", "$ a wrong.yaml  # exit 2\n"),
        ("The text has # not run in it.\n", "The text has # not run in it.\n"),
    ],
)
def test_the_site_shows_commands_without_the_marks_of_the_tests(written: str, shown: str) -> None:
    settings: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "conf.py"))
    content = [written]
    settings["_unmark"](None, "page", content)
    assert content == [shown]
