"""The common setup of all tests: a temporary folder, and the settings of hypothesis."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.tools import preloaded
from tests.tools.ctrl_c import mind_ctrl_c
from tests.tools.examples import examples
from tests.tools.leftovers import nothing_lives_on

__all__ = ["nothing_lives_on"]

# The time of an example means nothing on a busy machine: no deadline, unless a test is about time.
settings.register_profile("hedgerow", deadline=None, max_examples=examples(50), print_blob=True)
settings.load_profile("hedgerow")


def pytest_configure(config: pytest.Config) -> None:
    """Files that run side by side (`-n 3 --dist loadfile`) are begun in our order, not in xdist's."""
    config.option.loadscopereorder = False
    mind_ctrl_c()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files with the most slow tests come first: all processes end at about the same time."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


@pytest.fixture(scope="session", autouse=True)
def _preloaded(nothing_lives_on: None) -> Iterator[None]:
    """End the server of preloaded processes with the session."""
    yield
    preloaded.SESSION.close()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, and a list of running networks of the test's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path
