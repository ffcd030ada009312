"""Assertions on refusals by their code, whatever their words are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from hedgerow.topologies.errors import Code, HedgerowError


@contextlib.contextmanager
def refusal(code: Code, at: str = "") -> Iterator[pytest.ExceptionInfo[HedgerowError]]:
    """Check that the block raises an error of this code.

    `at` is the first field of its text: the option or the place.
    """
    with pytest.raises(HedgerowError) as raised:
        yield raised
    assert raised.value.code == code, raised.value
    assert str(raised.value).startswith(f"{at}: " if at else ""), raised.value
