"""Finding, opening and printing a finished page."""

import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from shj_bayes._util.did_you_mean import did_you_mean
from shj_bayes.cli import main
from shj_bayes.errors import ReportError
from shj_bayes.report import browse


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


def test_a_browser_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise subprocess.CalledProcessError(1, "chromium")

    monkeypatch.setattr(browse, "find_browser", lambda: "chromium")
    monkeypatch.setattr(subprocess, "run", fail)
    folder = folder_with(tmp_path / "a", "report.html")
    with pytest.raises(ReportError, match="could not print"):
        browse.write_pdf(folder / "report.html")
    assert [p.name for p in folder.iterdir()] == ["report.html"]


@pytest.mark.skipif(browse.find_browser() is None, reason="no Chromium on this machine")
def test_pdf_lies_beside_the_page(tmp_path: Path) -> None:
    page = folder_with(tmp_path / "a b", "report.html") / "report.html"
    pdf = browse.write_pdf(page)
    assert pdf == page.with_suffix(".pdf")
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
