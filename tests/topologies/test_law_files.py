"""A law that is named by the file of its class: the message names the class, without running the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies import law_files
from hedgerow.topologies.errors import TopologyError
from hedgerow.topologies.load import parse

ONE = "raise SystemExit('it ran')\nclass Sticky(Base):\n    pass\n"
TWO = "class Helper:\n    pass\nclass Slow:\n    def act(self, x): ...\n"


@pytest.mark.parametrize("name", ["sticky", "Sticky", "sticky.py", "./sticky.py", "sticky:", "stickyy"])
def test_the_class_of_the_file_is_named(name: str, here: Path) -> None:
    (here / "sticky.py").write_text(ONE)
    assert "sticky:Sticky" in law_files.hint(name)


def test_several_classes_are_listed_and_those_that_may_be_laws_come_first(here: Path) -> None:
    (here / "filters.py").write_text(TWO)
    assert law_files.hint("filters").index("Slow") < law_files.hint("filters").index("Helper")
    assert "filters:Helper" in law_files.hint("filters:helper2")


@pytest.mark.parametrize("text", [b"class (", b"\0", b"x = " + b"(" * 9999, b"x = 1", b"\xff\xfe", b"#" * 2**21])
def test_any_other_file_gives_no_hint(text: bytes, here: Path) -> None:
    (here / "odd.py").write_bytes(text)
    (here / "folder.py").mkdir()
    for name in ("odd", "folder", "", ".", "\0", "\ud800", "a" * 4000, "/etc/passwd", "missing"):
        assert law_files.hint(name) == ""


def test_the_message_of_a_file_has_the_hint(here: Path) -> None:
    (here / "sticky.py").write_text(ONE)
    with pytest.raises(TopologyError) as found:
        parse(b"{name: x, b: 0.1, steps: 3, seed: 1, nodes: [1], law: sticky}", "x.yaml", here)
    assert "sticky:Sticky" in str(found.value)
