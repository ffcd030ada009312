"""Text for a terminal, a log or a shell: no character acts on the terminal or ends a quoted word."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterable
from typing import TextIO

# The terminal obeys C0, DEL and C1. The bidirectional controls and the two separators change the order of the visible
# text. A lone surrogate is an invalid byte of UTF-8. Standard output would write that byte again, and 0x9B begins a
# command.
_UNSAFE = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
LAYOUT = "\n\t"
"""The control characters that lay out our own messages."""


def escape(text: str, keep: str = LAYOUT) -> str:
    r"""Return `text` with every control character written as `\uXXXX`, except those in `keep`.

    The notation is JSON's, so that escaped JSON stays JSON of the same value.
    """
    if text.isascii() and text.isprintable():
        return text
    return _UNSAFE.sub(lambda found: found[0] if found[0] in keep else f"\\u{ord(found[0]):04x}", text)


def shorten(text: str, most: int = 80) -> str:
    """Return a foreign text as one line of at most `most` characters."""
    cut = text if len(text) <= most else text[: most - 1] + "…"
    line = escape(cut, keep="")
    return line if len(line) <= most else line[: most - 1] + "…"


_MARKS = re.compile(r"[\\`*_{}\[\]<>#|~&!$]")


def markdown(text: str) -> str:
    """Return `text` as words of one Markdown line, without active emphasis, links, HTML or table cells."""
    return _MARKS.sub(r"\\\g<0>", escape(text, keep=""))


def echo(text: object, *, error: bool = False, end: str = "\n") -> None:
    """Print the escaped text to standard output, or to standard error if `error`, and flush it.

    Raise OSError if it cannot be written.
    """
    stream: TextIO = sys.stderr if error else sys.stdout
    print(escape(str(text)), file=stream, end=end, flush=True)


def command(words: Iterable[object]) -> str:
    """Return a command line for copy and paste: a shell reads exactly `words` from it.

    A word with control characters is written as $'…', which bash, zsh and POSIX 2024 know.
    """
    return " ".join(map(_quoted, map(str, words)))


def _quoted(word: str) -> str:
    if not _UNSAFE.search(word):
        return shlex.quote(word)
    inside = word.replace("\\", "\\\\").replace("'", "\\'")
    return f"$'{_UNSAFE.sub(_octal, inside)}'"


def _octal(found: re.Match[str]) -> str:
    """Return the bytes of a character in octal, three digits each, so each number has a definite end."""
    byte_of_a_path = "\udc80" <= found[0] <= "\udcff"
    data = found[0].encode(errors="surrogateescape" if byte_of_a_path else "surrogatepass")
    return "".join(f"\\{byte:03o}" for byte in data)
