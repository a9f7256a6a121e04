"""Templates with escaping: what goes into a page is text, whatever it holds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

import shj_bayes
from shj_bayes.files import write_text

PAGE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A picture on a page.

    Parameters
    ----------
    address : str
        The picture itself, as a data address.
    alt : str
        What it shows, for those who do not see it.
    caption : str
        What to see in it, one or two plain sentences.
    title : str
        A few words above it.
    wide : bool
        Takes the full width.
    """

    address: str
    alt: str
    caption: str
    title: str = ""
    wide: bool = False


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def write_page(folder: Path, template: str, content: dict[str, Any]) -> Path:
    """Fill a template and put the page into a folder, whole or not at all.

    Parameters
    ----------
    folder : Path
        Results folder.
    template : str
        Name of the template.
    content : dict
        What it needs.

    Returns
    -------
    Path
        The page.
    """
    text = _environment().get_template(template).render(version=shj_bayes.__version__, **content)
    path = folder / PAGE
    write_text(path, text)
    return path
