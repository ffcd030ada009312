"""HTML of a report: a browser reads every text as text."""

from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from hedgerow.orchestrator.report.markup import Markup, join, listed, table, tag
from hedgerow.topologies.escape import escape

PIECES = [
    "<",
    ">",
    "&",
    '"',
    "'",
    "</",
    "<!--",
    "-->",
    "<script>",
    "]]>",
    "&lt;",
    "=",
    "\x1b",
    "\u202e",
    "\udc9b",
    "\x00",
]
ANY = st.text(st.characters()) | st.lists(st.sampled_from(PIECES)).map("".join)


class Read(HTMLParser):
    """The result of a browser's reading: elements, attributes and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[str | None] = []
        self.text = ""
        self.other = 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [value for _, value in attrs]

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_comment(self, data: str) -> None:  # noqa: ARG002 (the parser passes it)
        self.other += 1

    def handle_decl(self, decl: str) -> None:  # noqa: ARG002 (the parser passes it)
        self.other += 1

    def unknown_decl(self, data: str) -> None:  # noqa: ARG002 (the parser passes it)
        self.other += 1

    def handle_pi(self, data: str) -> None:  # noqa: ARG002 (the parser passes it)
        self.other += 1


@given(ANY, ANY)
def test_any_text_stays_text(text: str, value: str) -> None:
    found = Read(tag("p", text, title=value))
    assert (found.tags, found.other) == (["p"], 0)
    assert found.text == escape(text)
    assert found.attributes == [escape(value, keep="")]


@given(st.lists(ANY, min_size=1), ANY)
def test_any_text_stays_text_in_tables_and_lists(texts: list[str], class_: str) -> None:
    found = Read(join([table(texts, [texts], class_), listed(texts)]))
    assert set(found.tags) <= {"div", "table", "thead", "tbody", "tr", "th", "td", "ul", "li"}
    assert found.tags.count("li") == len(texts)
    assert found.tags.count("th") == len(texts) + 1
    assert found.other == 0


@given(ANY)
def test_text_inside_markup_stays_text(text: str) -> None:
    """Only `tag` and `join` make markup: `+`, `%`, f-strings and the methods of str make text of it, to be escaped."""
    made = tag("b", text)
    for mixed in (made + text, f"{made}", made.upper(), "".join([made]), made[:2], made.replace("b", text), f"{made}"):
        assert not isinstance(mixed, Markup)
        assert Read(join([mixed])).tags == []
