"""Messages about single values: what was given, and what is expected."""

from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import Field, TypeAdapter, ValidationError

from hedgerow.topologies.wording import in_our_words


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (int, "x"),
        (float, "x"),
        (bool, 3),
        (str, 3),
        (list[int], 3),
        (dict[str, int], 3),
        (Annotated[int, Field(ge=1, le=9)], 10),
        (Annotated[float, Field(gt=0)], -1.5),
        (Annotated[str, Field(pattern="a+")], "b" * 5000),
    ],
)
def test_a_value_is_shown_without_the_words_of_the_library(kind: Any, value: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(kind).validate_python(value)
    (details,) = caught.value.errors()
    words = in_our_words(details)
    assert str(value)[:40] in words
    assert len(words) < 120
    assert "Input" not in words
    assert "input" not in words
