"""Times of the bench from the gesture to what is seen, in headless Chromium: ``python benchmarks/gestures.py``.

Files are simulated: two runs of 24 000 readings together, and one of 1.2 million. The bench is begun on an empty
folder; after the last gesture it is left alone, and its processor and memory are read where the system tells them
(Linux).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.recording import write_csv
from shj_bayes.report.browse import find_browser

TRUTH = Truth(gamma=1 / 60)
AIMS = {
    "bench open": "2 s",
    "loop of 24 000 readings": "0.7 s",
    "check and first answer": "1 s",
    "fit: intervals (in Chromium)": "3 s",
    "card: another number of connections": "0.3 s",
    "loop of 1.2 million readings": "4 s",
}


def main() -> None:
    """Print the table."""
    browser = find_browser()
    if browser is None:
        sys.exit("no Chromium, Chrome or Edge found")
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as play:
        place = Path(scratch)
        small = [write_csv(place / f"d-run{i}.csv", run) for i, run in enumerate(simulate_device(TRUTH, seed=1), 1)]
        (large,) = simulate_device(TRUTH, seed=2, rate_Hz=2000.0, n_runs=1)
        path = write_csv(place / "large.csv", large)
        chromium = play.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        with served(place / "lab") as (address, pid):
            page = chromium.new_page()
            times = gestures(page, address, small, path)
            print("| gesture | time | aim |\n|---|---|---|")
            for name, seconds in times.items():
                print(f"| {name} | {seconds:.2f} s | {AIMS[name]} |")
            page.close()
            idle(pid)
        chromium.close()


def gestures(page: Page, address: str, small: list[Path], large: Path) -> dict[str, float]:
    """Seconds of each gesture."""
    times = {}

    def timed(name: str, act: Callable[[], object], seen: str, patience_s: float = 120.0) -> None:
        begin = time.perf_counter()
        act()
        until(page, seen, patience_s)
        times[name] = time.perf_counter() - begin

    def opened() -> None:
        page.goto(address)
        page.wait_for_url("http://127.0.0.1:*/")

    timed("bench open", opened, "Boolean(document.getElementById('drop'))")
    until(page, "Boolean(bench.state.folder)")
    plot = "Boolean(document.querySelector('{} canvas.plot'))"
    timed("loop of 24 000 readings", lambda: page.set_input_files("#choose", small), plot.format("#file-detail"))
    until(page, "bench.state.files.length === 2 && document.getElementById('said').textContent.includes('read')")
    timed("check and first answer", lambda: page.click('#steps a[href="#fit"]'), plot.format("#device-detail"))
    timed("fit: intervals (in Chromium)", lambda: page.click("#fit-bar button.main"), "bench.devices()[0].fit !== ''")
    until(page, "Boolean(document.querySelector('#fit-result .badge'))")
    page.click('#steps a[href="#design"]')
    page.click("#pool")
    until(page, "Boolean(document.querySelector('#card table'))")
    page.wait_for_timeout(1000)
    words = "document.getElementById('card').innerText.includes('9 connections')"
    timed("card: another number of connections", lambda: page.fill("[name=connections]", "9"), words)
    page.click('#steps a[href="#files"]')
    seen = "document.querySelector('#file-detail h2')?.textContent === 'large.csv'"
    timed("loop of 1.2 million readings", lambda: page.set_input_files("#choose", large), seen)
    return times


def until(page: Page, expression: str, seconds: float = 240.0) -> None:
    """Wait for something; not by the library's own way, which the page's policy refuses."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        if time.monotonic() > end:
            sys.exit(f"{expression} did not come: {page.inner_text('#said')}")
        page.wait_for_timeout(20)


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, int]]:
    """Begin a bench; give the file that opens it, and its process."""
    command = [sys.executable, "-m", "shj_bayes", "bench", str(folder), "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().partition(": ")[2].strip(), process.pid
    finally:
        process.terminate()
        process.communicate(timeout=30)


def idle(pid: int) -> None:
    """Print processor and memory of a bench that nobody uses, two minutes later."""
    time.sleep(120)
    before = [seconds_of(one) for one in family(pid)]
    time.sleep(20)
    after = family(pid)
    used = sum(map(seconds_of, after)) - sum(before)
    memory = sum(memory_of(one) for one in after)
    print(
        f"\nidle: {100 * used / 20:.1f} % of a processor (aim 0), {memory:.0f} MB in {len(after)} processes (aim 250)"
    )


def family(pid: int) -> list[int]:
    """Give a process and those that it began."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text(encoding="ascii").split():
            found += family(int(child))
    return found


def seconds_of(pid: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def memory_of(pid: int) -> float:
    """Memory of a process, what it shares counted in part, MB."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / 1024.0
    return 0.0


if __name__ == "__main__":
    main()
