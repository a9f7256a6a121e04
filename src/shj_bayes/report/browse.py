"""Show a finished page: in the browser of the desk, or printed to PDF. Nothing is served."""

import os
import subprocess
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory

from shj_bayes._util.processes import program
from shj_bayes.errors import ReportError
from shj_bayes.report.page import is_ours

PAGES = ("report", "diagnosis", "margins", "plan")  # in the order in which they are looked for
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
WINDOWS = ("Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe")
PATIENCE_S = 120.0


def page_of(place: Path, which: str | None = None) -> Path:
    """Page of a results folder: the one asked for (report, diagnosis, margins, plan), or the first that is there.

    `ReportError` where there is none.
    """
    if place.suffix == ".html" and place.is_file():
        return place
    if not place.is_dir():
        raise ReportError(f"{place} is not a folder of results; name the one that was given to -o")
    found = {name: place / f"{name}.html" for name in PAGES if (place / f"{name}.html").is_file()}
    if which in found:
        return found[which]
    there = (
        f"it has {', '.join(found)}" if found else "it has none; run shj-bayes fit, diagnose, campaign or tables first"
    )
    if which is None and found:
        return next(iter(found.values()))
    raise ReportError(f"{place.name} holds no {which or 'page'}{'.html' if which else ''}; {there}")


def open_page(page: Path) -> bool:
    """Open a page in the browser of the desk; False when there is none to open it in."""
    return webbrowser.open(page.resolve().as_uri())


def write_pdf(page: Path) -> Path:
    """Print a page to PDF (A4), beside it; `ReportError` if no Chromium is installed, or it fails."""
    browser = find_browser()
    if browser is None:
        raise ReportError(
            f"no Chromium, Chrome or Edge was found to print {page.name} with; open the page and print it from there"
        )
    target = page.with_suffix(".pdf")
    with TemporaryDirectory(dir=page.parent, prefix=".pdf-") as part, TemporaryDirectory() as profile:
        made = Path(part) / target.name
        command = [browser, "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        command += ["--disable-sync", "--disable-component-update", "--disable-quic", f"--user-data-dir={profile}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            if not is_ours(page):
                raise ReportError(
                    f"{page.name} is not as this version wrote it, and Chromium prints for root only without its "
                    "sandbox; run the command again that made the page, or print it as another user"
                )
            command.append("--no-sandbox")  # Chromium does not start for root otherwise; only our script runs
        command += ["--no-pdf-header-footer", f"--print-to-pdf={made.resolve()}", page.resolve().as_uri()]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)
            os.replace(made, target)
        except (OSError, subprocess.SubprocessError) as error:
            raise ReportError(f"{Path(browser).name} could not print {page.name}: {type(error).__name__}") from error
    return target


def find_browser() -> str | None:
    """Program of a Chromium-like browser; None when there is none on the path or at its usual place on Windows."""
    on_path = next((found for name in BROWSERS if (found := program(name))), None)
    if on_path:
        return on_path
    roots = [os.environ[name] for name in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA") if name in os.environ]
    return next((str(p) for root in roots for tail in WINDOWS if (p := Path(root) / tail).is_file()), None)
