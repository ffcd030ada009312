"""Limits of the machine that are asked before something starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from hedgerow.topologies.errors import Code, HedgerowError
from hedgerow.wire.limits import need_threads


def grouped(root: Path, line: str, group: str, most: str, used: int) -> Path:
    """Lay out /proc and /sys of a process in a control group."""
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(f"{line}\n")
    where = root / "sys/fs/cgroup" / group
    where.mkdir(parents=True)
    (where / "pids.max").write_text(f"{most}\n")
    (where / "pids.current").write_text(f"{used}\n")
    return root


@pytest.mark.parametrize(
    ("line", "group"),
    [
        ("0::/user.slice/run.scope", "user.slice/run.scope"),
        ("0::/user.slice/run.scope", "user.slice"),
        ("8:pids:/docker/run", "pids/docker/run"),
        ("8:pids:/docker/run", "pids"),
        ("0::/", ""),
    ],
    ids=["v2", "v2 above", "v1", "v1 above", "container"],
)
def test_a_group_with_too_few_threads_is_named_before_anything_starts(tmp_path: Path, line: str, group: str) -> None:
    root = grouped(tmp_path, line, group, "100", 61)
    need_threads("a run", 39, root)
    with pytest.raises(HedgerowError) as refused:
        need_threads("a run", 40, root)
    assert refused.value.code == Code.LIMIT
    assert str(root / "sys/fs/cgroup" / group / "pids.max") in str(refused.value)


def test_a_group_without_a_limit_allows_all(tmp_path: Path) -> None:
    need_threads("a run", 40, grouped(tmp_path, "0::/", "", "max", 61))


def test_a_machine_without_control_groups_allows_all(tmp_path: Path) -> None:
    need_threads("a run", 40, tmp_path)
