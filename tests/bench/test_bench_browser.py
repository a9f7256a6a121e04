"""The bench as somebody uses it, in headless Chromium."""

import csv
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from serving import Served, write_device

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next((p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
DESK, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]
STEPS = ("files", "sets", "fit", "design", "keep")
Open = Callable[..., "sync_api.Page"]


@pytest.fixture(scope="module")
def browser() -> Iterator["sync_api.Browser"]:
    with sync_api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def show(browser: "sync_api.Browser") -> Iterator[Open]:
    """Open a bench; at the end nothing may have been said on the console, or asked of another machine."""
    noise: list[str] = []
    contexts = []

    def opened(bench: Served, **options: object) -> "sync_api.Page":
        context = browser.new_context(**{"viewport": DESK, **options})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: noise.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: noise.append(f"error: {error}"))
        page.on("dialog", lambda dialog: (noise.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        ours = (f"http://{bench.host}/", "data:", "blob:", "file:", "about:")
        page.on("request", lambda request: None if request.url.startswith(ours) else noise.append(request.url))
        page.goto(bench.way_in.as_uri())
        page.wait_for_url(f"http://{bench.host}/")
        until(page, "Boolean(bench.state.folder)")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert noise == []


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    served = Served.on(tmp_path / "lab")
    yield served
    assert "Traceback" not in served.end()


def until(page: "sync_api.Page", expression: str, seconds: float = 120.0) -> None:
    """Wait for something; not by the library's own way, which the page's policy refuses."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"{expression}: {page.locator('body').inner_text()[:2000]}")


def says(page: "sync_api.Page", words: str, seconds: float = 60.0) -> None:
    until(page, f"document.body.innerText.includes({words!r})", seconds)


def go(page: "sync_api.Page", step: str) -> None:
    page.locator(f'#steps a[href="#{step}"]').click()
    page.locator(f"main > #{step}").wait_for()


def test_from_files_to_the_card_of_two_sets(
    browser: "sync_api.Browser", show: Open, bench: Served, tmp_path: Path
) -> None:
    given = [
        path
        for i, (name, Fy) in enumerate((("bare-1", 80.0), ("bare-2", 84.0), ("zinc-1", 60.0)))
        for path in write_device(tmp_path, name, seed=i, Fy=Fy)
    ]
    page = show(bench)
    assert not page.locator("#designer").is_visible()
    page.set_input_files("#choose", given)
    says(page, "6 files read")
    assert page.locator("#file-rows tr").count() == 6
    assert page.locator("#file-rows .good").count() == 6
    go(page, "sets")
    assert page.locator(".set-card").count() == 2
    go(page, "fit")
    page.locator("#device-detail canvas.plot").wait_for()
    says(page, "90 % interval")
    page.get_by_role("button", name="Check and fit all").click()
    until(page, "document.querySelectorAll('#device-rows progress').length > 0")
    other = show(bench)  # a second tab sees the same
    go(other, "fit")
    for one in (page, other):
        until(one, "bench.devices().length === 3 && bench.devices().every((device) => device.fit)", 240)
    page.locator("#device-rows button").first.click()
    page.get_by_role("button", name="Report", exact=True).click()
    frame = page.frame_locator("iframe.page")
    frame.locator("h1").wait_for()
    assert "bare-1" in frame.locator("h1").inner_text()
    frame.locator("canvas.plot").first.wait_for()  # our own script runs in our own page
    go(page, "design")
    page.get_by_role("button", name="Compute the design forces").click()
    page.locator("#card table").first.wait_for(timeout=120_000)
    says(page, "all events: use these two")
    page.locator("[name=connections]").fill("12")
    says(page, "12 connections together")
    page.locator("[name=nominal_kN]").fill("-3")
    says(page, "nominal_kN = -3; allowed is a number above zero")
    page.locator("[name=nominal_kN]").fill("70")
    until(page, "document.getElementById('card').textContent.includes('stated by the user')")
    page.locator("#asked [name=set]").select_option(label="zinc")
    says(page, "zinc: forces")
    page.get_by_role("button", name="Compare", exact=True).click()
    page.locator("#comparison table").wait_for()
    kept_and_opened_again(show, page, tmp_path)
    accessible(browser, bench)


def kept_and_opened_again(show: Open, page: "sync_api.Page", tmp_path: Path) -> None:
    """One file holds everything: a bench on it shows the same card."""
    go(page, "keep")
    assert "shj-bayes campaign" in page.locator("#command").inner_text()
    with page.expect_download() as waiting:
        page.get_by_role("link", name="Download everything").click()
    waiting.value.save_as(tmp_path / "lab-again.zip")
    again = Served.on(tmp_path / "lab-again.zip")
    try:
        other = show(again)
        go(other, "design")
        other.locator("#card table").first.wait_for(timeout=60_000)
        other.close()
    finally:
        again.end()


def accessible(browser: "sync_api.Browser", bench: Served) -> None:
    """No complaint of axe at any step, light on a desk and dark on a phone, and nothing wider than the screen."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    context = browser.new_context(viewport=DESK, color_scheme="light", bypass_csp=True)
    page = context.new_page()
    page.goto(bench.way_in.as_uri())
    page.wait_for_url(f"http://{bench.host}/")
    wrong = []
    for step in STEPS:
        go(page, step)
        page.wait_for_timeout(1500)
        for summary in page.locator(f"#{step} summary:visible").all():
            summary.click()
        for scheme, size in (("light", DESK), ("dark", PHONE)):
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size(size)
            page.evaluate("new Promise(requestAnimationFrame)")
            if page.evaluate("document.documentElement.scrollWidth > window.innerWidth"):
                wrong.append((step, size["width"], "wider than the screen", []))
            for v in axe.Axe().run(page).response["violations"]:
                wrong.append((step, scheme, v["id"], [n["html"][:160] for n in v["nodes"]][:3]))
    context.close()
    assert wrong == []


def test_files_that_are_a_little_wrong(show: Open, bench: Served, tmp_path: Path) -> None:
    first, second = write_device(tmp_path, "good", seed=5)
    rows = list(csv.reader(line for line in first.read_text(encoding="utf-8").splitlines() if line[0] != "#"))
    unknown, broken, swapped = (tmp_path / name for name in ("unknown.csv", "broken.xlsx", "swapped.csv"))
    body = "\n".join(",".join(row) for row in rows[1:])
    unknown.write_text(f"a,b,c\n{body}\n", encoding="utf-8")
    broken.write_bytes(b"PK\x03\x04 not a workbook")
    swapped.write_text(f"time_s,force_kN,displacement_mm\n{body}\n", encoding="utf-8")
    page = show(bench)
    page.set_input_files("#choose", [first, unknown, broken, second, swapped])
    says(page, "5 files read")
    page.set_input_files("#choose", second)  # once more: it is here already
    says(page, "is here already")
    assert page.locator("#file-rows tr").count() == 5
    states = page.locator("#file-rows tr").all_inner_texts()
    assert sum("usable" in state for state in states) >= 2
    assert any("broken" in state and "cannot be read" in state for state in states)
    # Columns and units are chosen beside the first rows of the file.
    page.get_by_role("button", name="unknown.csv").click()
    page.locator("#file-detail select[name=time]").wait_for()
    for role, unit in (("time", "s"), ("displacement", "mm"), ("force", "kN")):
        column = {"time": "1", "displacement": "2", "force": "3"}[role]
        page.locator(f"#file-detail select[name={role}]").select_option(column)
        page.locator(f"#file-detail select[name={role}-unit]").select_option(unit)
    page.get_by_role("button", name="Read it so").click()
    page.locator("#file-detail canvas.plot").wait_for()
    says(page, "unknown.csv was read")
    # A file of the same form is read like it, without being asked.
    same = tmp_path / "same.csv"
    same.write_text(f"a,b,c\n{body}\n9999,0,0\n", encoding="utf-8")
    page.set_input_files("#choose", same)
    says(page, "1 file read")
    assert page.locator("#file-rows tr", has_text="same.csv").locator(".good").count() == 1
    page.get_by_role("button", name="swapped.csv").click()
    page.locator("#file-detail h2", has_text="swapped.csv").wait_for()
    assert (
        "swapped" in page.locator("#file-detail").inner_text()
        or "exchange" in page.locator("#file-detail").inner_text()
    )
    go(page, "fit")
    page.locator("#device-rows button", has_text="broken").click()
    says(page, "Not passed: broken.xlsx is not an XLSX workbook")
    assert page.locator("#fit-bar button.main:enabled").count() == 0


def test_cancelled_closed_and_opened_again_nothing_is_lost(show: Open, bench: Served, tmp_path: Path) -> None:
    page = show(bench)
    page.set_input_files("#choose", write_device(tmp_path, "c", seed=6))
    says(page, "2 files read")
    go(page, "fit")
    page.locator("#fit-bar button.main:enabled").click()
    page.locator("#fit-bar button", has_text="Cancel").click()
    until(page, "!document.querySelector('#fit-bar progress')")
    page.locator("#fit-bar button.main:enabled").click()
    until(page, "document.querySelector('#fit-bar progress')")
    page.close()
    page = show(bench)
    go(page, "fit")
    until(page, "bench.devices().every((device) => device.fit)")
    page.locator("#fit-result .badge").wait_for()


def test_thirty_files_are_dropped_at_once(show: Open, bench: Served, tmp_path: Path) -> None:
    path = write_device(tmp_path, "d", seed=7)[0]
    page = show(bench)
    page.evaluate(
        """(text) => {
          const data = new DataTransfer();
          for (let i = 1; i <= 30; i += 1) data.items.add(new File([`# ${i}\\n${text}`], `drop-${i}.csv`));
          const event = (kind) => new DragEvent(kind, { dataTransfer: data, bubbles: true, cancelable: true });
          document.getElementById("drop").dispatchEvent(event("dragover"));
          document.getElementById("drop").dispatchEvent(event("drop"));
        }""",
        path.read_text(encoding="utf-8"),
    )
    says(page, "30 files read", 120)
    assert page.locator("#file-rows .good").count() == 30
    go(page, "sets")
    assert page.locator(".device-item").count() == 30


def test_arranged_by_keyboard_and_by_dragging(show: Open, bench: Served, tmp_path: Path) -> None:
    given = [path for i in (1, 2) for path in write_device(tmp_path, f"k-{i}", seed=i)]
    page = show(bench)
    page.set_input_files("#choose", given)
    says(page, "4 files read")
    # To the second step, and there to every control, by Tab and Enter alone.
    page.locator("#steps a").nth(1).focus()
    page.keyboard.press("Enter")
    page.locator(".set-card").wait_for()
    seen = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        seen.add(
            page.evaluate("document.activeElement.getAttribute('aria-label') ?? document.activeElement.textContent")
        )
    assert {"New set", "name of set k", "name of device k-1", "later run: k-1-run1.csv"} <= seen
    page.get_by_label("later run: k-1-run1.csv").focus()
    page.keyboard.press("Enter")
    says(page, "k-1-run1.csv is run 2 now")
    page.get_by_label("name of device k-1").fill("first")
    page.keyboard.press("Tab")
    says(page, "Renamed to first")
    page.get_by_role("button", name="New set").click()
    until(page, "document.querySelectorAll('.set-card').length === 2")
    source, target = (
        page.locator(".device-item", has=page.get_by_label("name of device first")),
        page.locator(".set-card").nth(1),
    )
    source.drag_to(target, source_position={"x": 200, "y": 8}, target_position={"x": 300, "y": 12})
    says(page, "first was moved")
    assert (
        page.locator(".set-card").nth(1).locator(".device-item").count() == 2 or page.locator(".set-card").count() == 1
    )


def test_words_are_explained_where_they_stand(show: Open, served: Served) -> None:
    page = show(served)
    go(page, "sets")
    page.locator(".term", has_text="device").first.focus()
    assert "recordings in the order they were run" in page.locator("#meaning").inner_text()
    page.keyboard.press("Escape")
    assert page.locator("#meaning").is_hidden()


def test_an_example_opens_with_one_click(show: Open, served: Served) -> None:
    page = show(served)
    page.get_by_role("button", name="Prying taken for speed").click()
    page.locator("#device-detail canvas.plot").wait_for()
    says(page, "What this displacement history cannot tell apart")
