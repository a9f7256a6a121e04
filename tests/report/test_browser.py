"""The pages in a real browser: they open, show every picture and say nothing on the console."""

import shutil
import subprocess
from pathlib import Path

import pytest
from matplotlib.image import imread

from shj_bayes.report.device import render_device

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--enable-logging=stderr",
)

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


def browse(page: Path, profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert CHROMIUM
    command = [CHROMIUM, *OPTIONS, f"--user-data-dir={profile}", *options, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)


@pytest.fixture(scope="module")
def page(fitted: Path) -> Path:
    return render_device(fitted)


def test_opens_without_console_messages(page: Path, tmp_path: Path) -> None:
    done = browse(page, tmp_path / "profile", "--dump-dom")
    assert done.returncode == 0
    assert "</html>" in done.stdout
    assert "CONSOLE" not in done.stderr, done.stderr
    assert "Refused to" not in done.stderr


@pytest.mark.parametrize("size", ["1100,2400", "500,2400"])
def test_pictures_are_shown(page: Path, tmp_path: Path, size: str) -> None:
    shot = tmp_path / "page.png"
    browse(page, tmp_path / "profile", f"--window-size={size}", f"--screenshot={shot}")
    pixels = imread(shot)[..., :3]
    # The blue of the first picture's line (0, 114, 178): there only when the picture was drawn.
    blue = abs(pixels - [0.0, 114 / 255, 178 / 255]).sum(axis=2) < 0.08
    assert blue.sum() > 200


def test_prints_to_pdf(page: Path, tmp_path: Path) -> None:
    pdf = tmp_path / "page.pdf"
    browse(page, tmp_path / "profile", "--no-pdf-header-footer", f"--print-to-pdf={pdf}")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert pdf.stat().st_size > 50_000
