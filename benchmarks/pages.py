"""Size of pages and time to their first picture: ``python benchmarks/pages.py PAGE.html ...``.

A page of 24 000 samples a run comes from ``shj-bayes simulate -o big/a --rate 40`` and ``shj-bayes fit`` of its two
runs. The time is the browser's own first contentful paint, from the start of navigation, in a fresh headless Chromium;
it needs the Python package playwright and a Chromium on the path.
"""

from __future__ import annotations

import statistics
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

from shj_bayes.report.browse import find_browser

TRIES = 5
PAINTED = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0"
PICTURE = "[...document.images].length && document.images[0].complete && document.images[0].naturalWidth > 0"


def main() -> None:
    """Measure every page that is named."""
    browser = find_browser()
    if len(sys.argv) < 2 or browser is None:
        sys.exit(__doc__ if browser else "no Chromium on the path")
    with sync_playwright() as play:
        for name in sys.argv[1:]:
            page = Path(name).resolve()
            times = []
            for _ in range(TRIES):
                chromium = play.chromium.launch(executable_path=browser, args=["--no-sandbox", "--disable-gpu"])
                tab = chromium.new_page(viewport={"width": 1200, "height": 900})
                tab.goto(page.as_uri())
                while not (tab.evaluate(PICTURE) and tab.evaluate(PAINTED)):
                    tab.wait_for_timeout(20)
                times.append(float(tab.evaluate(PAINTED)))
                chromium.close()
            size = page.stat().st_size / 1e6
            middle = statistics.median(times)
            print(
                f"{page.parent.name}/{page.name}: {size:.2f} MB, first picture after {middle:.0f} ms, median of {TRIES}"
            )


if __name__ == "__main__":
    main()
