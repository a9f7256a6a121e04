"""What tests ask of a page, read as a browser would read it."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import read

OLD = Path(__file__).resolve().parents[1] / "fixtures" / "fit-0.1"


def read_old() -> FitRecord:
    """The record of a fit, to be changed."""
    return read(FitRecord, OLD)


class Page(HTMLParser):
    """Tags, texts and attributes of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.raw = path.read_text(encoding="utf-8")
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.code = False
        self.feed(self.raw)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.code = tag == "script"
        self.tags.append((tag, {key: value or "" for key, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        self.code = False

    def handle_data(self, data: str) -> None:
        if not self.code:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attrs for name, attrs in self.tags if name == tag]

    @property
    def outside(self) -> list[str]:
        """Addresses that leave the page or the folder, other than data and places on the page."""
        found = [a[key] for _, a in self.tags for key in ("src", "href", "action", "srcset", "poster") if key in a]
        return [address for address in found if not address.startswith(("data:image/", "#"))]


_TAGS = (
    "html head meta title style body header main nav footer p h1 h2 h3 ul li div span strong small data a figure img "
    "figcaption table caption thead tbody tr th td dl dt dd details summary script noscript"
)
ALLOWED_TAGS = frozenset(_TAGS.split(" "))


def check_scripts(page: Page, policy: str) -> None:
    """The only script that can run is ours: its digest stands in the policy; all others are data."""
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", page.raw, re.DOTALL)
    assert len(scripts) == page.raw.count("<script")
    code = [text for attributes, text in scripts if not attributes]
    assert len(code) == 1
    digest = base64.b64encode(hashlib.sha256(code[0].encode("utf-8")).digest()).decode("ascii")
    assert f"script-src 'sha256-{digest}'" in policy
    data = [(attributes, text) for attributes, text in scripts if attributes]
    for attributes, text in data:
        assert attributes == ' type="application/json" id="loops-data"'
        assert "<" not in text
        json.loads(text)


def check_safe(page: Page) -> None:
    """A page that loads nothing, runs nothing but our script and describes its pictures."""
    assert {name for name, _ in page.tags} <= ALLOWED_TAGS
    assert not any(key.startswith("on") for _, attrs in page.tags for key in attrs)
    policy = next(m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy.replace("style-src 'unsafe-inline'", "")
    check_scripts(page, policy)
    for image in page.all("img"):
        assert image["src"].startswith("data:image/")
        assert len(image["alt"]) > 20
    assert page.raw.count("<figcaption>") == len(page.all("img"))
    assert len(page.all("h1")) == 1
    assert page.all("html")[0]["lang"] == "en-GB"
    assert "@import" not in page.raw
    assert "url(" not in page.raw


def folded(page: Page, words: str) -> bool:
    """Whether the first place of `words` below the contents of a page is folded away."""
    before = page.raw[: page.raw.index(words, page.raw.index("</nav>"))]
    return before.count("<details") > before.count("</details>")
