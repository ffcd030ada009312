"""A need beyond a limit of the machine is refused before a library fails for it."""

from __future__ import annotations

import resource

import pytest

from hedgerow.topologies.errors import Code
from hedgerow.wire.limits import need
from tests.tools.refusals import refusal


@pytest.mark.parametrize(("name", "number"), [("open_files", resource.RLIMIT_NOFILE), ("memory", resource.RLIMIT_AS)])
def test_only_a_need_above_the_limit_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, number: int) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda asked: (5 * 10**6, -1) if asked == number else (-1, -1))
    need("a command", **{name: 5 * 10**6})
    with refusal(Code.LIMIT) as refused:
        need("a command", **{name: 6 * 10**6})
    assert "ulimit" in str(refused.value)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, -1))
    need("a command", **{name: 10**15})
