"""The option that a misspelt word means."""

from __future__ import annotations

from collections.abc import Iterable

EDIT, SWAP = 2, 1
"""The costs of a letter that is missing, added or other, and of two neighbours that changed places.

Swapped letters are the commonest slip of a fast typist: `--stesp` means `--steps`.
"""


def distance(one: str, other: str) -> int:
    """Return the least cost of edits and swaps between two words, where no letter is changed twice."""
    before: list[int] = []
    row = [EDIT * k for k in range(len(other) + 1)]
    for i, a in enumerate(one, 1):
        earlier, before, row = before, row, [EDIT * i]
        for j, b in enumerate(other, 1):
            cost = min(before[j] + EDIT, row[j - 1] + EDIT, before[j - 1] + EDIT * (a != b))
            if i > 1 and j > 1 and a == other[j - 2] and one[i - 2] == b:
                cost = min(cost, earlier[j - 2] + SWAP)
            row.append(cost)
    return row[-1]


def nearest(word: str, words: Iterable[str]) -> str | None:
    """Return the word of the least distance; None if more than a third of the letters of `word` would change."""
    allowed = EDIT * max(1, len(word.lstrip("-")) // 3)
    near = sorted((distance(word, one), one) for one in words if abs(len(one) - len(word)) * EDIT <= allowed)
    return near[0][1] if near and near[0][0] <= allowed else None
