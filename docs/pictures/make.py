"""Make the pictures of the README and the gallery anew: ``python docs/pictures/make.py``.

Runs the commands that stand beside them, in a temporary folder (about three minutes), and photographs the first screens
of the pages by a headless Chromium, which must be on the path. ``python docs/pictures/make.py FOLDER`` takes a finished
``shj-bayes demo`` from a folder instead of making one.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from shj_bayes.report.browse import find_browser

HERE = Path(__file__).resolve().parent
WIDTH, HEIGHT = 1000, 900
LARGEST_BYTES = 300_000


def main() -> None:
    """Make all results, photograph their pages, say what was written."""
    browser = find_browser()
    if browser is None:
        sys.exit("no Chromium, Chrome or Edge found")
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        demo = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else place / "demo"
        if not (demo / "campaign.json").is_file():
            shj_bayes("demo", "-o", str(demo), "--quiet")
        device = json.loads((demo / "campaign.json").read_text(encoding="utf-8"))["sets"][0]["devices"][0]["folder"]
        shj_bayes("tables", "--quiet", "-o", str(place / "tables"))
        pages = {
            "campaign": demo / "report.html",
            "device": demo / device / "report.html",
            "tables": place / "tables" / "report.html",
            "margins": place / "tables" / "margins.html",
        }
        for name, page in pages.items():
            picture = HERE / f"{name}.png"
            photograph(browser, page, picture)
            print(f"{picture.name}: {picture.stat().st_size // 1000} kB")
        bench(browser, place / "lab")


def bench(browser: str, folder: Path) -> None:
    """Photograph the bench with a checked and fitted device of the demo."""
    command = [sys.executable, "-m", "shj_bayes", "bench", str(folder), "--no-browser"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert served.stdout is not None
    address = served.stdout.readline().partition(": ")[2].strip()
    try:
        with sync_playwright() as play:
            page = play.chromium.launch(executable_path=browser, args=["--no-sandbox"]).new_page(
                viewport={"width": 1280, "height": HEIGHT}
            )
            page.goto(address)
            page.get_by_role("button", name="A clean device").click()
            page.locator("#fit-bar button.main:enabled").click(timeout=60_000)
            page.locator("#fit-result .badge").wait_for(timeout=240_000)
            page.locator("#said").evaluate("node => { node.textContent = ''; }")
            page.screenshot(path=HERE / "bench.png")
    finally:
        served.send_signal(signal.SIGINT)
        served.communicate(timeout=30)
    print(f"bench.png: {(HERE / 'bench.png').stat().st_size // 1000} kB")


def shj_bayes(*words: str) -> None:
    """Run one command of the tool."""
    subprocess.run([sys.executable, "-c", "from shj_bayes.cli import main; main()", *words], check=True)


def photograph(browser: str, page: Path, picture: Path) -> None:
    """Write the first screen of a page as PNG."""
    with tempfile.TemporaryDirectory() as profile:
        command = [browser, "--headless", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--no-sandbox"]
        command += ["--disable-background-networking", f"--user-data-dir={profile}"]
        command += [f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={picture}"]
        subprocess.run([*command, page.as_uri()], check=True, capture_output=True, timeout=120)
    if not picture.is_file() or picture.stat().st_size > LARGEST_BYTES:
        sys.exit(f"{picture.name} is missing or larger than {LARGEST_BYTES // 1000} kB")


if __name__ == "__main__":
    main()
