"""The settings of the site: `sphinx-build -W docs BUILD` writes its pages.

The pages are Markdown. The program itself describes the command line, and the docstrings describe the Python interface,
so both are read again at every build. Nothing is fetched: the build works without a network.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from hedgerow import __version__

project = "Hedgerow"
author = "The Hedgerow authors"
copyright = "2026, The Hedgerow authors"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "reference",
]
exclude_patterns = ["_build", "examples"]
source_suffix = {".md": "markdown"}

myst_enable_extensions = [
    "attrs_block",
    "attrs_inline",
    "colon_fence",
    "deflist",
    "dollarmath",
    "amsmath",
    "smartquotes",
]
myst_heading_anchors = 4
myst_fence_as_directive: list[str] = []

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
# An alias is one word in a signature; written out, the union of all kinds of faults would take a thousand letters.
autodoc_type_aliases = {name: name for name in ("Array", "Fault", "Index", "Mask", "Named")}
python_use_unqualified_type_names = True
# A long signature has one line per argument.
maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"Hedgerow {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {
    "source_repository": "",
    "light_css_variables": {"color-brand-primary": "#1b6e53", "color-brand-content": "#1b6e53"},
    "dark_css_variables": {"color-brand-primary": "#5fd0a5", "color-brand-content": "#5fd0a5"},
}
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True


def setup(app: Sphinx) -> None:
    """Name the file where CONTRIBUTING.md links to code, and remove the marks of our tests: readers copy commands."""
    app.connect("include-read", _name_sources)
    app.connect("source-read", _unmark)


def _name_sources(_app: Sphinx, _path: Path, _page: str, content: list[str]) -> None:
    content[0] = re.sub(r"\[(`[^`\]]+`)\]\((\w+/[\w/]+\.py)\)", r"\1 in `\2`", content[0])


def _unmark(_app: Sphinx, _page: str, content: list[str]) -> None:
    """Remove `# not run` behind commands: our tests leave out a command with this mark."""
    content[0] = re.sub(r"(?m)^(\$ .*?) +# not run[^\n]*$", r"\1", content[0])
