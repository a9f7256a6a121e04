"""The device page says what the files say, shows hostile names as text and needs nothing from outside."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from page_tools import Page, check_safe

from shj_bayes.errors import ShjError
from shj_bayes.report.data import read_device
from shj_bayes.report.device import render_device
from shj_bayes.report.words import rounded


@pytest.fixture(scope="module")
def page(fitted: Path) -> Page:
    return Page(render_device(fitted))


def test_numbers_are_those_of_the_summary(page: Page, summary: list[dict[str, float]]) -> None:
    exact = [attrs["value"] for attrs in page.all("data")]
    for row in summary:
        for key in ("mean", "sd", "q05", "q50", "q95"):
            assert repr(row[key]) in exact
        assert rounded(row["mean"], row["sd"]) in page.text


def test_first_screen_holds_verdict_numbers_and_one_picture(page: Page, fitted: Path) -> None:
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    first = page.raw[: page.raw.index("<nav")]
    assert f">{record['verdict']}<" in first
    assert first.count("<img") == 1
    assert all(f"{name}:" in first for name in ("K", "Fy", "ratio", "gamma"))
    assert "structured" in first or "Nothing beyond noise" in first or "noise" in first


def test_nothing_from_outside(page: Page) -> None:
    check_safe(page)
    assert page.outside == []


def test_hostile_names_are_text(page: Page, hostile_name: str) -> None:
    assert " ".join(hostile_name.split()) in page.text
    assert "49" not in [word for word in page.text.split() if word.startswith("49")] or "{{ 7*7 }}" in page.text


def test_alias_warning_with_one_peak_speed(page: Page) -> None:
    assert (
        "With one peak speed a loss of friction away from mid-stroke looks exactly like speed dependence" in page.text
    )


def test_provenance(page: Page, fitted: Path) -> None:
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert record["model"]["priors_sha256"] in page.text
    assert record["versions"]["numpy"] in page.text
    assert "Simulated data." in page.text


def test_same_files_same_page(page: Page, copy_of: Path) -> None:
    def plain(raw: str) -> str:
        return re.sub(r'data:image/[^"]+', "", raw)

    again = render_device(copy_of).read_text(encoding="utf-8")
    assert plain(again) == plain(page.raw)


def test_page_is_small(page: Page) -> None:
    assert len(page.raw) < 3_000_000


def test_folder_without_a_fit(tmp_path: Path) -> None:
    with pytest.raises(ShjError, match="no finished fit"):
        render_device(tmp_path)


def test_damaged_posterior_is_one_clear_error(copy_of: Path) -> None:
    (copy_of / "posterior.nc").write_bytes(b"not a file of draws")
    (copy_of / "report.html").write_text("old", encoding="utf-8")
    with pytest.raises(ShjError, match="cut short or altered"):
        render_device(copy_of)
    assert (copy_of / "report.html").read_text(encoding="utf-8") == "old"


def test_pyplot_keeps_no_figures(page: Page) -> None:
    """Nothing is drawn on global state."""
    assert page.raw
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []


def test_loss_between_runs_has_its_travel_beside_it(fitted: Path) -> None:
    """A ratio belongs to the travel between the runs; per metre it can be compared between protocols."""
    device = read_device(fitted)
    travel = device.runs[0].travel_m
    x = device.runs[0].displacement_mm
    assert travel == pytest.approx(np.abs(np.diff(x)).sum() / 1000, rel=0.02)
    assert f"after {travel:.3g} m of travel in the first" in " ".join(Page(render_device(fitted)).text.split())
