"""Text for a terminal, a log or a shell: no character acts on the terminal or ends a quoted word."""

from __future__ import annotations

import contextlib
import re
import shlex
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

# The terminal obeys C0, DEL and C1. The bidirectional controls and the two separators change the order of the visible
# text. A lone surrogate is an invalid byte of UTF-8. Standard output would write that byte again, and 0x9B begins a
# command. Invisible characters make two names look equal. The two joiners (U+200C, U+200D) stay, because scripts need
# them.
_UNSAFE = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)
LAYOUT = "\n\t"
"""The control characters that lay out our own messages."""


def escape(text: str, keep: str = LAYOUT) -> str:
    r"""Return `text` with every control character written as `\uXXXX`, except those in `keep`.

    The notation is JSON's, so that escaped JSON stays JSON of the same value.
    """
    if text.isascii() and text.isprintable():
        return text
    return _UNSAFE.sub(lambda found: found[0] if found[0] in keep else _written_out(found[0]), text)


def _written_out(character: str) -> str:
    number = ord(character)
    if number > 0xFFFF:  # JSON writes it as two surrogates
        high, low = divmod(number - 0x10000, 0x400)
        return f"\\u{0xD800 + high:04x}\\u{0xDC00 + low:04x}"
    return f"\\u{number:04x}"


def shorten(text: str, most: int = 80) -> str:
    """Return a foreign text as one line of at most `most` characters."""
    cut = text if len(text) <= most else text[: most - 1] + "…"
    line = escape(cut, keep="")
    return line if len(line) <= most else line[: most - 1] + "…"


_MARKS = re.compile(r"[\\`*_{}\[\]<>#|~&!$]")


def markdown(text: str) -> str:
    """Return `text` as words of one Markdown line, without active emphasis, links, HTML or table cells."""
    return _MARKS.sub(r"\\\g<0>", escape(text, keep=""))


_answers: TextIO | None = None


def answers() -> TextIO:
    """Return the stream of a command's answer: standard output."""
    return _answers or sys.stdout


@contextlib.contextmanager
def answers_alone() -> Iterator[None]:
    """Redirect other prints to standard error while the block lasts, so that standard output has only the answer.

    A law may print. A program that reads JSON could not read those lines.
    """
    global _answers
    before = _answers, sys.stdout
    _answers, sys.stdout = answers(), sys.stderr
    try:
        yield
    finally:
        _answers, sys.stdout = before


def echo(text: object, *, error: bool = False, end: str = "\n") -> None:
    """Print the escaped text to standard output, or to standard error if `error`, and flush it.

    Raise OSError if it cannot be written.
    """
    stream = sys.stderr if error else answers()
    print(escape(str(text)), file=stream, end=end, flush=True)


class EscapedStream:
    """The standard output or error of a process, with escaped text from any code.

    A law that prints, a warning and the traceback of a thread do not pass through `echo`.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.rich_proxied_file = stream
        """The stream without escapes, which rich looks for under this name: a live table consists of controls."""

    def write(self, text: str) -> int:
        """Write the escaped text, and return the length of `text`."""
        self._stream.write(escape(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write the escaped lines."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the stream."""
        return getattr(self._stream, name)


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
