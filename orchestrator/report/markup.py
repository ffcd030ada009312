"""HTML made from parts: everything that is not markup already is text, and is escaped."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from hedgerow.topologies.escape import escape


class Markup(str):
    """HTML; only `tag` and `join` make it."""

    __slots__ = ()


_VOID = {"img", "meta", "link"}


def join(parts: Iterable[object]) -> Markup:
    """Return the concatenation of parts; text among them is escaped, with its control characters."""
    return Markup("".join(part if isinstance(part, Markup) else html.escape(escape(str(part))) for part in parts))


def tag(name: str, /, *inside: object, **attributes: str) -> Markup:
    """Return an element; a trailing underscore of an attribute's name is dropped, other underscores become hyphens."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{html.escape(escape(value, keep=""))}"'
        for key, value in attributes.items()
    )
    opened = f"<{name}{written}>"
    return Markup(opened if name in _VOID else f"{opened}{join(inside)}</{name}>")


def table(headings: Sequence[object], rows: Iterable[Sequence[object]], class_: str = "") -> Markup:
    """Return a table with row names in the first column; it scrolls sideways on a narrow page."""
    head = tag("thead", tag("tr", *(tag("th", one, scope="col") for one in headings)))
    body = (tag("tr", tag("th", row[0], scope="row"), *(tag("td", cell) for cell in row[1:])) for row in rows)
    return tag("div", tag("table", head, "\n", tag("tbody", *_lines(body)), class_=class_), class_="wide")


def listed(items: Iterable[object]) -> Markup:
    """Return a list."""
    return tag("ul", *_lines(tag("li", item) for item in items))


def _lines(parts: Iterable[Markup]) -> Iterable[object]:
    for part in parts:
        yield part
        yield "\n"
