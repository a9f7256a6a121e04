"""Templates with escaping: what goes into a page is text, whatever it holds."""

import base64
import hashlib
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup

import shj_bayes
from shj_bayes._util.files import read_bytes, write_text
from shj_bayes.errors import ReportError
from shj_bayes.report import words

PAGE = "report.html"
MAX_PAGE = 64 * 1024**2  # bytes; pages have a few MB
_SEAL = "\n<!-- SHA-256 of what stands above: "
_HEAD = (
    '<!DOCTYPE html>\n<html lang="en-GB">\n<head>\n<meta charset="utf-8">\n'
    '<meta http-equiv="Content-Security-Policy" content="{}">\n'
)
TABLES, LOOPS = ("sheet", "tables"), ("sheet", "tables", "loops")  # scripts of a page, in the order they run


class Picture(NamedTuple):
    """A picture on a page."""

    address: str  # the picture itself, as a data URI
    alt: str  # what it shows, for those who do not see it
    caption: str  # what to see in it, one or two plain sentences
    title: str = ""  # a few words above it
    wide: bool = False  # takes the full width


# A space between a number and its unit.
GAP = re.compile(r"(?<=\d) (?=%|(?:kN|N|mm|m|s|min|Hz|kJ|J|MPa|degC)\b)")


def kept_together(value: Any) -> Any:
    """Give a text in which no line breaks between a number and its unit; everything else as it is."""
    return GAP.sub("\N{NO-BREAK SPACE}", value) if isinstance(value, str) and not isinstance(value, Markup) else value


@cache
def environment_of(*packages: str) -> jinja2.Environment:
    """Templates of packages, those of the first before those of the next, with escaping."""
    made = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package) for package in packages]),
        autoescape=True,
        finalize=kept_together,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["words"] = words  # numbers are written where they stand
    return made


@cache
def script(names: tuple[str, ...]) -> Markup:
    """Scripts of this package, named without ending, as one text that may stand in a page as it is.

    Indentation is left out, which takes a fifth off; there is no other minifier to trust.
    """
    sources = [(Path(__file__).parent / "scripts" / f"{name}.js").read_text(encoding="utf-8") for name in names]
    return Markup("\n".join(line.strip() for source in sources for line in source.splitlines()))


@cache
def policy(text: Markup) -> Markup:
    """Content-security policy of a page: no network at all, and no script but the one whose text has this digest.

    Source: W3C Content Security Policy Level 3, section 8.4 (hash of the inline script's text, SHA-256, base64).
    """
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return Markup(
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )


def head(scripts: tuple[str, ...] = TABLES) -> dict[str, Any]:
    """Give what every page needs: version, scripts and the policy that allows those alone."""
    code = script(scripts)
    return {"version": shj_bayes.__version__, "script": code, "policy": policy(code)}


def write_page(
    folder: Path, template: str, content: dict[str, Any], scripts: tuple[str, ...] = TABLES, *, name: str = ""
) -> Path:
    """Fill a template and put the page into a folder, whole or not at all; without its scripts it is a plain page.

    The page has the name of the template where no other is given.
    """
    text = environment_of("shj_bayes.report").get_template(template).render(**head(scripts), **content)
    path = folder / (name or template)
    write_text(path, text + _seal(text))
    return path


def is_ours(page: Path) -> bool:
    """Whether a page is as `write_page` of this version left it, so that no script but ours runs in it.

    Its last line is the digest of the rest, and its policy, before which nothing stands but the kind of the document,
    is that of our scripts.
    """
    try:
        text = read_bytes(page, MAX_PAGE, ReportError).decode("utf-8")
    except (ReportError, ValueError):
        return False
    body, mark, _ = text.rpartition(_SEAL)
    heads = [_HEAD.format(policy(script(names))) for names in (TABLES, LOOPS)]
    return bool(mark) and text == body + _seal(body) and body.startswith(tuple(heads))


def _seal(text: str) -> str:
    return f"{_SEAL}{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()} -->\n"
