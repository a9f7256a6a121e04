"""The documentation site: ``python tasks.py docs`` builds it into ``build/docs``; warnings are errors."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

import shj_bayes

project = "shj-bayes"
author = copyright = "The shj-bayes developers"
version = release = shj_bayes.__version__
language = "en_GB"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
exclude_patterns = ["README.md", "schemas"]
html_theme = "furo"
html_title = "shj-bayes"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
autodoc_typehints = "none"  # types stand in the numpydoc sections already
autodoc_member_order = "bysource"
napoleon_google_docstring = False
html_math_renderer = "mathml"

HERE = Path(__file__).parent
MORE = ("margins.md", "proof.md", "security.md", "speed.md", "stories/*.md", "decisions/0*.md")  # where they are there
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+((?:README|CONTRIBUTING|CHANGELOG|SECURITY|data|priors|reports)[^)]*)\)")


def _inside(app: Any, name: str, source: list[str]) -> None:
    """Put the pages that are there into the contents; links to files outside the site become their names."""
    if name == "index":
        pages = [page.relative_to(HERE).with_suffix("") for pattern in MORE for page in sorted(HERE.glob(pattern))]
        named = source[0].splitlines()
        found = [path.as_posix() for path in pages if path.as_posix() not in named]
        source[0] = source[0].replace("@more", "\n".join(found))
    source[0] = OUTSIDE.sub(r"\1 (`\2` in the project)", source[0])


def _mathml(block: bool) -> Any:
    """Equations as MathML: browsers draw it themselves, so that the site works without a network."""

    def visit(self: Any, node: nodes.Element) -> None:
        self.body.append(convert(node.astext(), display="block" if block else "inline"))
        raise nodes.SkipNode

    return visit


def setup(app: Any) -> None:
    """Hooks of this site."""
    app.connect("source-read", _inside)
    app.add_html_math_renderer("mathml", (_mathml(False), None), (_mathml(True), None))
