"""The pages of the documentation that messages name: an installed package has no docs folder."""

from __future__ import annotations

from functools import cache

TITLES = {"guarantee": "Guarantee of the law", "laws": "Laws", "topology": "Topology files"}
"""By file in docs/: the heading of a page that a message names."""


@cache  # the look-up reads the disk
def site() -> str:
    """Return the address of the site, from the project URL `Documentation` of this release; empty without one."""
    from importlib.metadata import PackageNotFoundError, metadata  # noqa: PLC0415 (only a message needs it)

    try:
        urls = metadata("hedgerow").get_all("Project-URL") or []
    except PackageNotFoundError:
        return ""
    named = (url.partition(",") for url in urls)
    return next((address.strip().rstrip("/") for name, _, address in named if name == "Documentation"), "")


def page(name: str) -> str:
    """Return where a page is: its address, or its title if this release names no site."""
    title = TITLES[name]
    return f"{site()}/{name}.html" if site() else f"the page “{title}” of the documentation"
