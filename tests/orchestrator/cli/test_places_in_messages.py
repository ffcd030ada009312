"""Messages name the option that the user gave, and no option that the user did not give."""

from __future__ import annotations

from pathlib import Path

import pytest

import hedgerow as hg
from hedgerow.orchestrator.experiments.worst import worst
from hedgerow.orchestrator.views.rerun.viewer import choose_one
from hedgerow.topologies.errors import Code, UserError


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="no /proc")
def test_worst_refuses_an_unwritable_folder_by_the_given_path() -> None:
    with pytest.raises(UserError) as caught:
        worst(hg.load("paper7"), 0.1, steps=10, out=Path("/proc/x.yaml"))
    assert caught.value.code == Code.OUTPUT
    assert str(caught.value).startswith("--out /proc/x.yaml")


def test_open_without_a_display_blames_the_option_only_if_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    begins = {}
    for asked in ("auto", "native"):
        with pytest.raises(UserError) as caught:
            choose_one(asked, "instead")
        begins[asked] = str(caught.value).startswith(f"--viewer {asked}")
    assert begins == {"auto": False, "native": True}
