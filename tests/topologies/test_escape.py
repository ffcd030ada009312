"""Text for a terminal, a log and a shell: no character acts, and a shell reads the intended words."""

import ast
import io
import json
import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hedgerow.wire.child
from hedgerow.orchestrator.metrics.message_audit import STRANGE_KEYS, _shortened
from hedgerow.topologies.escape import command, escape, markdown, shorten
from hedgerow.wire.child import Line

ANY = st.text(st.characters())
"""Any text, lone surrogates included."""
ACTS = {
    *range(0x20),
    *range(0x7F, 0xA0),
    *(0x61C, 0x200E, 0x200F, 0x2028, 0x2029),
    *range(0x202A, 0x202F),
    *range(0x2066, 0x206A),
    *range(0xD800, 0xE000),
}
HOSTILE = "\x1b]0;owned\x07\x9b2J\u202e\udc9b"
MANY = ANY | st.text(st.sampled_from([chr(one) for one in ACTS]) | st.characters())


@given(MANY)
def test_no_character_of_any_text_acts_on_a_terminal(text: str) -> None:
    assert not {ord(one) for one in escape(text)} & (ACTS - {0x0A, 0x09})
    assert not {ord(one) for one in escape(text, keep="")} & ACTS
    escape(text).encode()  # the rest can be written
    assert escape(escape(text)) == escape(text)


@pytest.mark.parametrize("character", sorted(one for one in ACTS - {0x0A, 0x09} if one < 0xD800 or one % 0x100 == 0x9B))
def test_each_control_is_written_out(character: int) -> None:
    assert escape(f"a{chr(character)}b") == f"a\\u{character:04x}b"


@given(st.text(st.characters(exclude_categories=["Cc", "Cf", "Cs", "Zl", "Zp"])))
def test_other_text_stays_as_it_is(text: str) -> None:
    assert escape(text) == text


@given(st.lists(st.text(st.characters(exclude_categories=["Cs"]))))  # JSON joins two lone surrogates to one character
def test_escaped_json_has_the_same_value(value: object) -> None:
    for ensure_ascii in (True, False):
        assert json.loads(escape(json.dumps(value, ensure_ascii=ensure_ascii))) == value


@given(MANY)
def test_a_shortened_text_is_one_line_of_at_most_80_characters(text: str) -> None:
    assert len(shorten(text)) <= 80
    assert not {ord(one) for one in shorten(text)} & ACTS


@given(MANY, MANY)
def test_a_log_line_is_one_line(name: str, text: str) -> None:
    record = logging.LogRecord(name, logging.INFO, "", 1, "%s", (text,), None)
    assert not {ord(one) for one in Line().format(record)} & (ACTS - {0x09})


def test_a_traceback_keeps_its_lines() -> None:
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(Line())
    logger = logging.Logger("test")
    logger.addHandler(handler)
    try:
        raise ValueError(HOSTILE)
    except ValueError:
        logger.exception("it failed")
    text = stream.getvalue()
    assert text.count("\n") >= 3
    assert not {ord(one) for one in text} & (ACTS - {0x0A, 0x09})


@given(st.dictionaries(MANY, st.integers(), max_size=40))
def test_strange_keys_are_few_and_short(strange: dict[str, int]) -> None:
    found = _shortened(strange)
    assert len(found) <= STRANGE_KEYS + 1
    assert all(len(key) <= 80 and not {ord(one) for one in key} & ACTS for key in found)
    assert all(abs(number) < 2**63 for number in found.values())


def test_a_shell_reads_the_words_of_a_command() -> None:
    words = [
        "plain",
        "",
        "a b",
        "$(touch x)",
        "`x`",
        "'",
        '"',
        "\\",
        "a;b&c|d",
        "#2",
        "~",
        "-x",
        "!1",
        "*",
        "ü",
        "\x1b[2J",
    ]
    words += ["a\nb", "\t", "\x7f7", "\x011", "caf\udce9", "\u202e'\\", "{a,b}", "\x9b2J"]
    printed = command(["printf", "%s\\0", *words])
    assert not {ord(one) for one in printed} & ACTS
    read = subprocess.run(["bash", "-c", printed], capture_output=True, check=True, timeout=60).stdout
    assert read == b"".join(word.encode(errors="surrogateescape") + b"\0" for word in words)


@given(MANY)
def test_a_command_shows_no_control(text: str) -> None:
    assert not {ord(one) for one in command([text])} & ACTS


def test_markdown_has_no_mark_of_a_text() -> None:
    assert markdown("a|b *c* [d](e) <f> `g` \\ \n\x1b") == (r"a\|b \*c\* \[d\](e) \<f\> \`g\` \\ \\u000a\\u001b")


@given(MANY)
def test_every_mark_of_markdown_is_escaped(text: str) -> None:
    printed = markdown(text)
    assert not {ord(one) for one in printed} & ACTS
    assert not set("|*_<>[]`") & set(re.sub(r"\\.", "", printed))


def test_only_echo_prints() -> None:
    """A separate `print` would be a way to the screen without escapes."""
    root = Path(hedgerow.wire.child.__file__).resolve().parents[1]
    assert (root / "topologies" / "escape.py").is_file()
    found = []
    for package in ("topologies", "wire", "agents", "plant", "orchestrator"):
        for file in (root / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_bytes())):
                if not isinstance(node, ast.Call):
                    continue
                called = ast.unparse(node.func)
                if called in ("print", "typer.echo", "sys.stdout.write", "sys.stderr.write"):
                    found.append(f"{file.relative_to(root)}:{node.lineno}")
    assert [place for place in found if not place.startswith("topologies/escape.py")] == []


def test_a_warning_without_a_log_is_escaped() -> None:
    """A session warns of the keys of strangers, and the operator's process has no log."""
    code = (
        "import logging; from hedgerow.wire.child import escape_warnings; escape_warnings();"
        rf" logging.getLogger('x').warning('key %s', {HOSTILE[:-1]!r})"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, check=True, timeout=60)
    assert b"key " in done.stderr
    assert not {ord(one) for one in done.stderr.decode()} & (ACTS - {0x0A})
