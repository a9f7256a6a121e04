"""The documentation site builds without a warning and asks nothing of a network."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shj_bayes.report.browse import find_browser

for name in ("sphinx", "furo", "myst_parser", "sphinx_click", "latex2mathml"):
    pytest.importorskip(name, reason=f"{name} is not installed; python tasks.py docs installs it")
TOP = Path(__file__).resolve().parents[2]
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)=\"((?:https?:)?//[^\"]+)\"")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(TOP / "docs"), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"})
    assert done.returncode == 0, done.stderr
    return out


def test_every_page_is_built(site: Path) -> None:
    pages = [p for p in (TOP / "docs").rglob("*.md") if p != TOP / "docs" / "README.md"]
    missing = [p.name for p in pages if not (site / p.relative_to(TOP / "docs")).with_suffix(".html").is_file()]
    assert missing == []


def test_equations_and_commands_are_there(site: Path) -> None:
    assert "<math" in (site / "method/model.html").read_text(encoding="utf-8")
    commands = (site / "reference/commands.html").read_text(encoding="utf-8")
    assert all(f"shj-bayes-{name}" in commands for name in ("fit", "diagnose", "campaign", "open"))
    assert "FitResult" in (site / "reference/api.html").read_text(encoding="utf-8")


def test_nothing_is_loaded_from_a_network(site: Path) -> None:
    loaded = {page.name: found for page in site.rglob("*.html") if (found := LOADED.findall(page.read_text("utf-8")))}
    assert loaded == {}


def test_a_link_to_nowhere_is_an_error(tmp_path: Path) -> None:
    shutil.copytree(TOP / "docs" / "_static", tmp_path / "_static")
    shutil.copy(TOP / "docs" / "conf.py", tmp_path / "conf.py")
    (tmp_path / "index.md").write_text("# A\n\n[gone](nowhere.md)\n", encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", str(tmp_path), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "nowhere" in done.stderr


@pytest.mark.skipif(find_browser() is None, reason="no Chromium on this machine")
def test_site_is_accessible(site: Path) -> None:
    """Nothing that axe calls serious or critical, on a desk and on a phone, with what the theme leaves out put in."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    wrong = []
    with sync_api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=find_browser(), args=["--no-sandbox", "--disable-gpu"])
        page = chromium.new_page()
        for name in ("index", "start", "method/model", "reference/commands"):
            page.goto((site / f"{name}.html").as_uri())
            for width in (1200, 390):
                page.set_viewport_size({"width": width, "height": 900})
                found = axe.Axe().run(page).response["violations"]
                wrong += [(name, v["id"], v["nodes"][0]["html"][:100]) for v in found if v["impact"] != "minor"]
        chromium.close()
    assert wrong == []
