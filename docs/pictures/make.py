"""Take the two pictures of the README: ``python docs/pictures/make.py [CAMPAIGN_FOLDER]``.

The folder is one that ``shj-bayes demo`` wrote (``shj-bayes-demo`` by default). The first screen of its campaign page
and of its first device's page are photographed by a headless Chromium, which must be on the path.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
WIDTH, HEIGHT = 1000, 900
LARGEST_BYTES = 300_000


def main() -> None:
    """Photograph both pages; say what was written."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "shj-bayes-demo").resolve()
    record = folder / "campaign.json"
    if not record.is_file():
        sys.exit(f"{folder.name} holds no campaign.json; run shj-bayes demo first, or name its folder")
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"no browser found; one of {', '.join(BROWSERS)} must be on the path")
    device = json.loads(record.read_text(encoding="utf-8"))["sets"][0]["devices"][0]["folder"]
    for name, page in (("campaign", folder / "report.html"), ("device", folder / device / "report.html")):
        picture = HERE / f"{name}.png"
        photograph(browser, page, picture)
        print(f"{picture.name}: {picture.stat().st_size // 1000} kB")


def photograph(browser: str, page: Path, picture: Path) -> None:
    """Write the first screen of a page as PNG."""
    with tempfile.TemporaryDirectory() as profile:
        command = [browser, "--headless", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--no-sandbox"]
        command += [f"--user-data-dir={profile}", f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={picture}"]
        subprocess.run([*command, page.as_uri()], check=True, capture_output=True, timeout=120)
    if not picture.is_file() or picture.stat().st_size > LARGEST_BYTES:
        sys.exit(f"{picture.name} is missing or larger than {LARGEST_BYTES // 1000} kB")


if __name__ == "__main__":
    main()
