"""Finding, opening and printing a finished page."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from shj_bayes.cli import main
from shj_bayes.errors import ReportError, did_you_mean
from shj_bayes.report import browse, page
from shj_bayes.report.campaign import render_campaign
from shj_bayes.report.page import is_ours


@pytest.fixture
def campaign_page(tmp_path: Path) -> Path:
    """A page that was written by this tool."""
    (tmp_path / "campaign.json").write_text(
        '{"schema": "shj-bayes/campaign/1", "name": "x", "sets": []}', encoding="utf-8"
    )
    return render_campaign(tmp_path)


def folder_with(root: Path, *names: str) -> Path:
    root.mkdir(exist_ok=True)
    for name in names:
        (root / name).write_text("<!DOCTYPE html><title>x</title><p>y</p>", encoding="utf-8")
    return root


def test_the_page_that_is_meant_is_found(tmp_path: Path) -> None:
    both = folder_with(tmp_path / "a", "report.html", "diagnosis.html")
    assert browse.page_of(both).name == "report.html"
    assert browse.page_of(both, "diagnosis").name == "diagnosis.html"
    assert browse.page_of(both / "diagnosis.html").name == "diagnosis.html"
    assert browse.page_of(folder_with(tmp_path / "b", "diagnosis.html")).name == "diagnosis.html"


def test_no_page_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"holds no margins\.html; it has report"):
        browse.page_of(folder_with(tmp_path / "a", "report.html"), "margins")
    with pytest.raises(ReportError, match="run shj-bayes fit"):
        browse.page_of(folder_with(tmp_path / "b"))
    with pytest.raises(ReportError, match="not a folder of results"):
        browse.page_of(tmp_path / "none")


def test_open_serves_nothing_and_says_what_it_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    folder = folder_with(tmp_path / "a b#c", "report.html")
    done = CliRunner().invoke(main, ["open", str(folder)])
    assert done.exit_code == 0
    assert opened == [(folder / "report.html").resolve().as_uri()]
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    assert "open this file yourself" in CliRunner().invoke(main, ["open", str(folder)]).output


def test_pdf_without_a_browser_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(browse, "find_browser", lambda: None)
    with pytest.raises(ReportError, match="print it from there"):
        browse.write_pdf(folder_with(tmp_path / "a", "report.html") / "report.html")


def test_a_browser_that_fails_leaves_nothing(
    tmp_path: Path, campaign_page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise subprocess.CalledProcessError(1, "chromium")

    monkeypatch.setattr(browse, "find_browser", lambda: "chromium")
    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(ReportError, match="could not print"):
        browse.write_pdf(campaign_page)
    assert {p.name for p in tmp_path.iterdir()} == {"report.html", "campaign.json"}


FOREIGN: dict[str, Callable[[str], str]] = {
    "hand-made": lambda _: "<!DOCTYPE html><script>alert(1)</script>",
    "changed": lambda text: text.replace("<body", "<!-- --><body"),
    "without our policy": lambda text: text.replace("default-src 'none'", "default-src *"),
    "longer": lambda text: text + "<script>alert(1)</script>",
    "script before the policy": lambda text: text.replace("<head>", "<head><script>alert(1)</script>"),
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("again", [False, True])
def test_root_prints_no_page_of_others(
    campaign_page: Path, monkeypatch: pytest.MonkeyPatch, kind: str, again: bool
) -> None:
    """Also one whose digest was computed again, if scripts of others could run in it."""
    started: list[list[str]] = []
    monkeypatch.setattr(browse, "find_browser", lambda: "chromium")
    monkeypatch.setattr(os, "geteuid", lambda: 0, raising=False)
    monkeypatch.setattr(subprocess, "run", lambda command, **_: started.append(command))
    assert is_ours(campaign_page)
    text = FOREIGN[kind](campaign_page.read_text(encoding="utf-8"))
    if again:
        body = text.rpartition(page._SEAL)[0] or text
        text = body + page._seal(body)
    campaign_page.write_text(text, encoding="utf-8")
    if again and kind in ("changed", "longer"):
        assert is_ours(campaign_page)  # the policy lets no script of others run
        return
    with pytest.raises(ReportError, match="not as this version wrote it"):
        browse.write_pdf(campaign_page)
    assert started == []


@pytest.mark.skipif(browse.find_browser() is None, reason="no Chromium on this machine")
def test_pdf_lies_beside_the_page(campaign_page: Path) -> None:
    pdf = browse.write_pdf(campaign_page)
    assert pdf == campaign_page.with_suffix(".pdf")
    assert pdf.read_bytes().startswith(b"%PDF")


def test_windows_places_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    edge = tmp_path / "Microsoft/Edge/Application/msedge.exe"
    edge.parent.mkdir(parents=True)
    edge.touch()
    monkeypatch.setattr("shj_bayes.report.browse.program", lambda _: None)
    monkeypatch.setenv("PROGRAMFILES", str(tmp_path))
    assert browse.find_browser() == str(edge)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_of_the_command(shell: str) -> None:
    done = CliRunner().invoke(main, ["completion", shell])
    assert done.exit_code == 0
    assert "_SHJ_BAYES_COMPLETE" in done.output


@pytest.mark.parametrize(
    ("word", "answer"), [("pryng", "; did you mean 'prying'?"), ("WEAR", "; did you mean 'wear'?"), ("xyzzy", "")]
)
def test_the_nearest_word_is_named(word: str, answer: str) -> None:
    assert did_you_mean(word, ("prying", "wear", "slack")) == answer
