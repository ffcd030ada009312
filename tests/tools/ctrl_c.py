"""Ctrl-C for programs in which a background shell has disabled it."""

from __future__ import annotations

import signal


def mind_ctrl_c() -> None:
    """Restore the default action of SIGINT in the processes that we start."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
