"""How texts and bytes go wrong, for the fuzzer."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Sequence

Random = random.Random

# ---- how a text goes wrong

PIECES = (
    *(b"\n", b" ", b"\t", b":", b": ", b"- ", b"[", b"]", b"{", b"}", b"#", b"&a ", b"*a", b"!!x ", b"---\n", b"..."),
    *(b"'", b'"', b"|\n", b">\n", b"%YAML 1.1\n", b"? ", b"<<: ", b"!!python/object/apply:os.system ", b"\0", b"\xff"),
    *(b"\xef\xbb\xbf", b"\r", b"\xe2\x80\xa8", b"\xed\xa0\x80", "é".encode(), b"\x1b[2J", b"\x85"),
)
VALUES = (
    *(b"0", b"-1", b"1e400", b"-1e400", b".nan", b".inf", b"1e-320", b"1" * 400, b"9" * 5000, b"-0.0", b"1e308"),
    *(b"9223372036854775807", b"9223372036854775808", b"18446744073709551616", b"2147483648", b"1_000", b"0x1F"),
    *(b"~", b"true", b"no", b"", b"random", b"worst_case", b"none", b"[]", b"{}", b"[[]]", b"{random: 1000000}"),
    *(b"{random: 9223372036854775807}", b"1000000000000", b"'" + b"x" * 10_000 + b"'", b"[1, 2]", b"{a: {b: {c: d}}}"),
    *(b"../../../../etc/passwd", b"/dev/zero", b"/etc/hostname", b"con", b"a.csv", b"http://x/y", b"\\\\host\\share"),
    *(b"os:system", b"antigravity:x", b"this:c", b"nowhere.at_all:Law", b"minimax:", b":", b".:x", b"a..b:C"),
    *(b"{kind: samples, file: w.csv}", b"{kind: samples, file: ../w.csv}", b"{kind: samples, values: []}"),
    *(b"{kind: white, std: 1e308}", b"[{kind: crash, node: 1, at: 99999999999}]", b"{kind: sinusoid, omega: 1e308}"),
)
_NUMBER = re.compile(rb"-?\d+(\.\d+)?(e-?\d+)?")
_DIGIT = re.compile(rb"\d")


def bent_text(text: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """A text after a few slips, or with something hostile in it."""
    slips, hostile = rng.choice(((1, False), (2, False), (1, True), (2, True), (3, True), (8, True)))
    for _ in range(slips):
        at = rng.randrange(len(text) + 1)
        lines = text.splitlines(keepends=True) or [b""]
        k = rng.randrange(len(lines))
        match rng.randrange(11) if hostile else rng.choice((0, 2, 6, 10, 10, 10)):
            case 0:
                text = text[:at] + rng.choice(PIECES) + text[at + rng.randrange(4) :]
            case 1:
                text = text[:at] + text[at + rng.randrange(1, 40) :]
            case 2 | 3 | 4:
                text = _swapped(_NUMBER, text, VALUES, rng)
            case 5:
                key, colon, _ = lines[k].partition(b":")
                lines[k] = key + colon + b" " + rng.choice(VALUES) + b"\n"
                text = b"".join(lines)
            case 6:
                lines[k : k + 1] = rng.choice(([], [lines[k]] * 2, [rng.choice(lines)], [lines[k], rng.choice(lines)]))
                text = b"".join(lines)
            case 7:
                other = rng.choice(others)
                text = text[:at] + other[rng.randrange(len(other) + 1) :]
            case 8 if rng.random() < 0.3:
                text = _bomb(rng) + text
            case 8:
                depth = rng.choice((10, 40, 2000, 100_000))
                pair = rng.choice(((b"[", b"]"), (b"{a: ", b"}"), (b"- ", b""), (b'{"a":', b"}")))
                text = text[:at] + pair[0] * depth + rng.choice((b"", pair[1] * depth)) + text[at:]
            case 9:
                text = bent_bytes(text, rng)
            case 10:
                text = _swapped(_DIGIT, text, (b"0", b"1", b"4", b"9"), rng)
    return text


def _swapped(what: re.Pattern[bytes], text: bytes, values: Sequence[bytes], rng: Random) -> bytes:
    """The text with one of the places that match as another value."""
    places = [match.span() for match in what.finditer(text)]
    if not places:
        return text
    start, stop = rng.choice(places)
    return text[:start] + rng.choice(values) + text[stop:]


def _bomb(rng: Random) -> bytes:
    """Aliases that multiply: few lines, a great many values."""
    wide, deep = rng.choice((2, 9, 30)), rng.choice((3, 9, 25))
    lines = [b"a0: &a0 [x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * wide)}]".encode() for k in range(1, deep)]
    return b"\n".join(lines) + b"\n"


# ---- how bytes go wrong

NUMBERS = tuple(
    struct.pack(form, value)
    for form, values in {
        "<q": (0, -1, 1, 2**31, 2**63 - 1, -(2**63), 10**12),
        "<i": (0, -1, 1, 2**31 - 1, -(2**31), 65536),
        "<H": (0, 1, 0xFFFF),
        "<B": (0, 1, 0x7F, 0x80, 0xFF),
        "<d": (float("nan"), float("inf"), -1e308, 5e-324),
    }.items()
    for value in values
)


def bent_bytes(content: bytes, rng: Random) -> bytes:
    """Bytes after some of them were lost, doubled, moved or changed."""
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        at = rng.randrange(len(content) + 1)
        length = rng.choice((1, 2, 4, 8, 16, 100, 1000))
        match rng.randrange(8):
            case 0:
                content = content[:at]
            case 1:
                content = content[:at] + content[at + length :]
            case 2:
                content = content[:at] + rng.randbytes(length) + content[at + length :]
            case 3:
                content = content[:at] + bytes(length) + content[at + length :]
            case 4 | 5:
                number = rng.choice(NUMBERS)
                content = content[:at] + number + content[at + len(number) :]
            case 6:
                content = content[:at] + content[at : at + length] + content[at:]
            case 7 if content:
                at = min(at, len(content) - 1)
                content = content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
    return content
