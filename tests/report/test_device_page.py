"""The device page says what the files say, shows hostile names as text and needs nothing from outside."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest
from page_tools import Page, check_safe, folded, read_old

from shj_bayes.app.resume import device_text
from shj_bayes.errors import ShjError
from shj_bayes.report.device import badges, content, render_device
from shj_bayes.report.figures import canvas
from shj_bayes.report.figures.device import draw as draw_page
from shj_bayes.report.numbers import left_over, numbers_of
from shj_bayes.report.words import CONVERGENCE, ForceUnit, force_unit, rounded
from shj_bayes.results.device import read_device
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.fit import Remark, RemarkRecord, Trust

SVG = "{http://www.w3.org/2000/svg}"


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
    assert f">{CONVERGENCE[record['convergence']][0]}<" in first
    assert "of Fy unexplained" in first
    assert first.count("<img") == 1
    assert all(f"{name}:" in first for name in ("K", "Fy", "beta", "ratio", "gamma"))


def test_a_tentative_verdict_of_a_converged_fit_is_told_on_the_first_screen() -> None:
    record = replace(read_old(), convergence=Trust.RELIABLE, verdict=Trust.TENTATIVE)
    told = badges(record, LeftOver(24.0, 12, 3.2))[0]
    assert told["name"] == "converged"
    assert "The verdict is tentative" in told["words"]
    assert "tentative" not in badges(replace(record, verdict=Trust.RELIABLE), LeftOver(1.0, 12))[0]["words"]


def test_what_is_not_looked_at_first_is_folded_away(page: Page) -> None:
    later = ("Prior predictive check", "Provenance", "corner plot", "Verdict of the fit", "Backbone", "Force over time")
    assert [words for words in later if not folded(page, words)] == []
    first = ("Loops, measured and modelled", "Residuals along the stroke", "R-hat", "full cycles dissipated")
    assert [words for words in first if folded(page, words)] == []


def test_a_small_device_is_shown_in_newton(copy_of: Path) -> None:
    """0.26 kN is no number that a laboratory reads off its load cell."""
    device = read_device(copy_of)
    small = ForceUnit("kN", 0.002)
    rows = [replace(small.row(row), unit=row.unit) for row in device.record.parameters]
    record = replace(device.record, parameters=tuple(rows))
    unit, capacity = force_unit(record), record.parameter("Fy")
    assert capacity is not None
    assert (unit.name, unit.row(capacity).unit) == ("N", "N")
    assert unit.row(capacity).q50 == pytest.approx(1000 * capacity.q50)
    assert unit.of("kN/mm") == ("N/mm", 1000.0)
    assert unit.of("s/mm") == ("s/mm", 1.0)
    assert force_unit(device.record).name == "kN"
    shown = device._replace(record=record)
    told = content(shown, numbers_of(shown), left_over(shown))
    assert {card["unit"] for card in told["cards"]} == {"N/mm", "N", "", "s/mm"}
    assert told["force_unit"] == "N"


def test_what_the_data_do_not_determine_is_no_number(fitted: Path) -> None:
    """K 3678 +- 660 000 is no stiffness: neither the first screen, nor the table, nor the terminal prints it."""
    device = read_device(fitted)
    remark = RemarkRecord(parameter="K", kind=Remark.UNDETERMINED, q50=3678.0, prior_q05=5.0, prior_q95=60.0)
    record = replace(device.record, remarks=(remark,))
    changed = device._replace(record=record)
    told = content(changed, numbers_of(changed), left_over(changed))
    assert told["remarks"][0].startswith("K is not determined by this recording: it may lie almost anywhere")
    assert next(card for card in told["cards"] if card["name"] == "K")["value"] == "not determined"
    assert next(row for row in told["rows"] if row["name"] == "K")["unknown"]
    text = device_text(fitted, record)
    line = next(line for line in text.splitlines() if line.startswith("  K "))
    assert line.split() == ["K", "not", "determined", "kN/mm"]


def test_nothing_from_outside(page: Page) -> None:
    check_safe(page)
    assert page.outside == []


def test_hostile_names_are_text(page: Page, hostile_name: str) -> None:
    assert "{{ 7*7 }}" in hostile_name
    assert " ".join(hostile_name.split()) in page.text


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


def words_in(picture: str) -> Iterator[tuple[str, tuple[float, float, float, float], tuple[float, float]]]:
    """Each text of a picture with the box that it takes up, left, top, right and bottom, and the size of the sheet."""
    sheet = ElementTree.fromstring(unquote(picture.partition(",")[2]))
    size = tuple(map(float, sheet.attrib["viewBox"].split()[2:]))
    for diagram in sheet.findall(f"{SVG}g"):
        left, top = map(float, re.findall(r"[-.\d]+", diagram.attrib["transform"]))
        for text in diagram.findall(f"{SVG}text"):
            x, y, *turned = map(float, re.findall(r"[-.\d]+", text.attrib["transform"]))
            letters = str(text.text)
            high = float(text.attrib["font-size"])
            wide = len(letters) * high * canvas.LETTER
            begin = {"start": 0.0, "middle": -wide / 2, "end": -wide}[text.attrib["text-anchor"]]
            box = (begin, -high, begin + wide, 0.0) if not turned else (-high, -begin - wide, 0.0, -begin)
            yield letters, tuple(a + b for a, b in zip((x + left, y + top) * 2, box, strict=True)), size  # type: ignore[misc]


def pictures_in(drawn: Any) -> Iterator[str]:
    """All addresses of pictures in what a page draws."""
    if isinstance(drawn, str) and drawn.startswith("data:"):
        yield drawn
    for one in drawn.values() if isinstance(drawn, dict) else drawn if isinstance(drawn, list | tuple) else ():
        yield from pictures_in(one)


def test_points_on_a_line_are_left_out_and_nothing_else_is() -> None:
    """Every point of a loop, with its corners and a gap, lies on the drawn line to within a third of a pixel or so."""
    turn = np.linspace(0, 2 * np.pi, 4001)
    x, y = 900 * np.sin(turn), np.clip(2500 * np.cos(turn), -700, 700)
    x[2100:2300] = np.nan
    path = ElementTree.fromstring(canvas._path(x, y, "")).attrib["d"]
    pieces = [np.array(re.findall(r"-?\d+", piece), dtype=float).reshape(-1, 2) for piece in path[1:].split("M")]
    assert len(pieces) == 2
    ends = [np.cumsum(piece, axis=0) for piece in pieces]
    begin, step = np.concatenate([one[:-1] for one in ends]), np.concatenate([piece[1:] for piece in pieces])
    assert len(step) < 400
    drawn = np.stack([x, y], axis=1)[np.isfinite(x), None] - begin
    along = np.clip((drawn * step).sum(axis=2) / np.maximum((step**2).sum(axis=1), 1e-9), 0, 1)
    assert np.hypot(*(drawn - along[..., None] * step).T).min(axis=0).max() < 2
    for a, b in ((0, 2099), (2300, 4000)):
        assert np.hypot(*(ends[a > 0][[0, -1]] - np.stack([x, y], axis=1)[[a, b]]).T).max() < 1


def test_nothing_stands_beyond_the_edge_of_a_picture(copy_of: Path) -> None:
    """The margins are fixed: the numbers and titles of every diagram must find room in them, also large ones."""
    device = read_device(copy_of)
    numbers = numbers_of(device)
    for factor in (1.0, 0.001):  # of Fy: a small device is drawn in newton, whose numbers are long
        rows = tuple(replace(row, q50=row.q50 * factor) for row in device.record.parameters)
        shown = device._replace(record=replace(device.record, parameters=rows))
        found = [one for picture in pictures_in(draw_page(shown, numbers)) for one in words_in(picture)]
        assert len(found) > 200
        beyond = [
            (words, box) for words, box, (wide, high) in found
            if box[0] < 0 or box[1] < 0 or box[2] > wide or box[3] > high
        ]  # fmt: skip
        assert beyond == []


def test_numbers_beside_one_another_do_not_touch(copy_of: Path) -> None:
    device = read_device(copy_of)
    for picture in pictures_in(draw_page(device, numbers_of(device))):
        boxes = [(words, box) for words, box, _ in words_in(picture) if box[3] - box[1] < box[2] - box[0]]
        for k, (words, one) in enumerate(boxes):
            for others, two in boxes[:k]:
                apart = one[0] >= two[2] or two[0] >= one[2] or one[1] + 1 >= two[3] or two[1] + 1 >= one[3]
                assert apart, (words, others)


def test_page_is_small(page: Page) -> None:
    assert len(page.raw) < 1_600_000


def test_folder_without_a_fit(tmp_path: Path) -> None:
    with pytest.raises(ShjError, match=r"holds no fit\.json"):
        render_device(tmp_path)


def test_damaged_posterior_is_one_clear_error(copy_of: Path) -> None:
    (copy_of / "posterior.nc").write_bytes(b"not a file of draws")
    (copy_of / "report.html").write_text("old", encoding="utf-8")
    with pytest.raises(ShjError, match="cut short or altered"):
        render_device(copy_of)
    assert (copy_of / "report.html").read_text(encoding="utf-8") == "old"


def test_loss_between_runs_has_its_travel_beside_it(fitted: Path) -> None:
    """A ratio belongs to the travel between the runs; per metre it can be compared between protocols."""
    device = read_device(fitted)
    travel = device.runs[0].travel_m
    x = device.runs[0].displacement_mm
    assert travel == pytest.approx(np.abs(np.diff(x)).sum() / 1000, rel=0.02)
    assert f"after {travel:.3g} m of travel in the first" in " ".join(Page(render_device(fitted)).text.split())
