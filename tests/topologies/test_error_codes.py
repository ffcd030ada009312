"""Every raised mistake names its kind: a code, or the option at the start of the message."""

import ast

from hedgerow.topologies.errors import Code, UserError
from tests.test_fuzz import sources
from tests.tools.fuzz import ROOT


def begins(message: ast.expr) -> str:
    """Return the beginning of a message, as far as the source has it."""
    match message:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=[first, *_]):
            return begins(first)
        case ast.IfExp(body=body):
            return begins(body)
    return ""


def test_no_mistake_has_the_generic_code() -> None:
    found = []
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(func=ast.Name(id="UserError"), args=args, keywords=words):
                    names_option = bool(args) and begins(args[0]).startswith("--")
                    if not (names_option or any(word.arg == "code" for word in words)):
                        found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not found, "give each a code of topologies.errors.Code"


def test_a_message_that_begins_with_an_option_is_of_that_option() -> None:
    assert UserError("--rate -1: is below 0. Give 0 or more.").code == Code.OPTION
    assert UserError("--out runs: is a file. Name a folder.", code=Code.OUTPUT).code == Code.OUTPUT
    assert UserError("topo.yaml: is wrong").code == Code.USER
