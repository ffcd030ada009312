"""What all tests share: a place of their own, and how examples are tried."""

from pathlib import Path

import pytest
from hypothesis import settings

# How long an example may take says nothing on a busy machine: no deadline, unless a test is about time.
settings.register_profile("hedgerow", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("hedgerow")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, and a list of running networks of the test's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path
