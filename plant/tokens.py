"""The liveliness tokens of the agents: which processes are there, and which are left from an earlier run."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from hedgerow.plant.allowance import TOKENS_AT_ONCE, TOKENS_PER_S, Allowance

_KEY = re.compile(r"alive/shard-([0-9]{1,9})/([0-9]{1,9})(?:-([0-9]{1,10}))?")


class Token(NamedTuple):
    """The token of one life of a shard, and the number of the plant that it names, if it names one."""

    shard: int
    life: int
    plant: int | None


class Tokens:
    """The tokens seen by one plant; it accepts a limited rate of changes per shard."""

    def __init__(self, shards: int, plant: int, see: Callable[[int, int, bool], None]) -> None:
        """`plant` is our number. `see` receives the shard, its life, and True if the token is present."""
        self._plant, self._see = plant, see
        self._allowances = [Allowance(TOKENS_PER_S, TOKENS_AT_ONCE) for _ in range(shards)]
        self._late: dict[int, tuple[int, bool]] = {}
        """by shard: the newest change above the rate limit, which is processed later"""
        self.left_behind: set[str] = set()
        """agents of an earlier run that are still there"""

    def read(self, key: str) -> Token | None:
        """Return the token with a key; None if it is no token of a shard."""
        match = _KEY.fullmatch(key)
        if match is None or int(match[1]) >= len(self._allowances):
            return None
        return Token(int(match[1]), int(match[2]), None if match[3] is None else int(match[3]))

    def take(self, token: Token, there: bool) -> bool:
        """Process a token that appeared or vanished; return False if that is put off."""
        p, life, plant = token
        if plant is not None and plant != self._plant:
            # An agent of an earlier run: it leaves when it sees our token, and until then would answer our states.
            (self.left_behind.add if there else self.left_behind.discard)(f"shard-{p}/{life}-{plant}")
            return True
        if p in self._late or not self._allowances[p].take():
            if life >= self._late.get(p, (life, there))[0]:
                self._late[p] = life, there
            return False
        self._see(p, life, there)
        return True

    def take_late(self) -> bool:
        """Process the tokens that were put off, as far as the limit permits now; return True if there was one."""
        due = [p for p in self._late if self._allowances[p].take()]
        for p in due:
            self._see(p, *self._late.pop(p))
        return bool(due)
