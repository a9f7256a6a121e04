"""The campaign page and the page of the published tables."""

from pathlib import Path

import numpy as np
import pytest
from made_campaign import make_campaign, population
from page_tools import Page, check_safe, folded

from shj_bayes.app.design import band_text
from shj_bayes.errors import ShjError
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.predict import new_device_table
from shj_bayes.report import sets
from shj_bayes.report.campaign import render_campaign, render_tables
from shj_bayes.report.figures import population as figures
from shj_bayes.results.campaign import safe_folder
from shj_validation.paper_claims import paper_claims


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, fitted: Path, hostile_name: str) -> Path:
    return make_campaign(tmp_path_factory.mktemp("campaign"), fitted, hostile_name)


@pytest.fixture(scope="module")
def page(campaign: Path, hostile_name: str) -> Page:
    return Page(render_campaign(campaign, population((hostile_name, "other"))))


def test_page_is_safe_and_links_stay_below(page: Page, hostile_name: str) -> None:
    check_safe(page)
    assert page.outside == ["devices/one-12ab34/report.html"]
    assert " ".join(hostile_name.split()) in page.text
    assert "<img src=x onerror=1> is 80000 kN" in page.text


def test_new_device_bands_are_those_of_the_population(page: Page, hostile_name: str) -> None:
    result = population((hostile_name, "other"))
    exact = {attrs["value"] for attrs in page.all("data")}
    for row in new_device_table(result):
        if row["quantity"] in sets.SHOWN and row["set"] != ANY_SET:
            assert repr(float(row["q50"])) in exact


@pytest.mark.parametrize(("n", "shown"), [(4, False), (5, True)])
def test_a_set_never_tested_is_left_out_where_its_band_would_be_assumption(n: int, shown: bool) -> None:
    result = population(tuple("abcde"[:n]))
    bands = sets.set_bands(result)
    assert all((rows[-1].name == sets.NEVER) == shown for rows in bands.values())
    loops = sets.loop_bands(result, 95.0, 10.0)
    assert (loops[-1].set_name == ANY_SET) == shown
    assert ("a set never tested" in band_text(result)) == shown
    assert ("4 tested sets do not tell how much sets differ" in band_text(result)) != shown


def test_devices_stand_open_and_what_was_pooled_is_folded_away(page: Page) -> None:
    assert not folded(page, "Left over by the model")
    assert all(folded(page, words) for words in ("Sets side by side", "The loop of a new device", "their digests"))


def test_devices_and_failures_are_counted(page: Page) -> None:
    assert "3 of 4 devices were fitted" in page.text
    assert "1 failed" in page.text
    assert "Simulated data." in page.text
    assert "Two devices are not a band" in page.text
    assert "Nothing is said of a set that was never tested: 2 tested sets" in page.text


def test_first_screen_shows_the_force_that_devices_deliver(campaign: Path, hostile_name: str, page: Page) -> None:
    """Fy is the force at standstill: it stood there alone, 75 to 85 kN, where tests had measured 91 to 100."""
    assert "sliding force of a new device at standstill (Fy)" in page.text
    levels = {"plateau": (84.4, 93.4, 104.0), "plateau_2": (70.8, 80.3, 89.3)}
    rows = [
        {"set": "other", "quantity": q, "method": "new device", "side": side, "value": x, "monte_carlo_error": 0.4}
        for q, values in levels.items()
        for side, x in zip(("low", "middle", "high"), values, strict=True)
    ]
    record = {"margins": rows, "tested": {"fastest_mm_s": 10.24}}
    told = Page(render_campaign(campaign, population((hostile_name, "other")), margins=record)).text
    card = told[told.index("other: force that a new device delivers") :]
    assert (
        card.index("84.5 to 104 kN")
        < card.index("at the tested speed (up to 10.2 mm/s)")
        < card.index("Fy, by the law")
    )
    assert "In the second run 71.0 to 89.5 kN" in card


def test_campaign_without_a_population(campaign: Path) -> None:
    page = Page(render_campaign(campaign))
    check_safe(page)
    assert "No device could be used" in page.text


def test_no_campaign_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ShjError, match=r"holds no campaign\.json"):
        render_campaign(tmp_path)
    (tmp_path / "campaign.json").write_text('{"name": "x", "sets": [{"name": 3}]}', encoding="utf-8")
    with pytest.raises(ShjError, match=r"campaign\.json in .* has none of the schemas"):
        render_campaign(tmp_path)


@pytest.mark.parametrize(
    ("place", "safe"),
    [
        ("devices/a-1", True),
        ("a", True),
        ("../x", False),
        ("devices/../../x", False),
        ("/etc", False),
        ("javascript:alert(1)", False),
        ("a\\b", False),
        ("", False),
        ("devices//x", False),
        ("a\n", False),
    ],
)
def test_only_folders_below_are_linked(place: str, safe: bool) -> None:
    assert safe_folder(place) is safe


def test_matrix_is_settled_only_when_sets_are_apart() -> None:
    close, apart = (sets.force_matrix(population(("a", "b"), shift=s)) for s in (0.0, 0.8))
    assert close[0][0] is None
    assert close[0][1] is not None
    assert not close[0][1][1]
    assert apart[1][0] is not None
    assert apart[1][0][1]
    assert apart[1][0][0][1] == pytest.approx(np.exp(0.8), rel=0.02)


def test_bands_hold_the_other_priors_and_the_devices() -> None:
    band = sets.set_bands(population(("a", "b")))["Fy"][0]
    assert band.widest[0] <= band.band[0] < band.band[1] < band.band[2] <= band.widest[1]
    assert [round(middle, 1) for _, (_, middle, _) in band.devices] == [78.4, 81.6]


def test_tables_page(tmp_path: Path) -> None:
    claims = paper_claims()
    page = Page(render_tables(tmp_path / "new", population(("a", "b", "c")), claims))
    check_safe(page)
    assert page.outside == []
    for claim in claims:
        assert " ".join(claim.sentence.split()) in page.text
    assert "With one peak speed" in page.text


@pytest.mark.parametrize(("n", "crowded"), [(24, False), (25, True)])
def test_many_devices_do_not_hide_the_band(monkeypatch: pytest.MonkeyPatch, n: int, crowded: bool) -> None:
    """Above a number their dots get a lane beside the band, in one stroke."""
    drawn = []
    monkeypatch.setattr(figures, "drawn", lambda figure, *_: drawn.append(figure))
    devices = tuple((f"d{k}", (70.0 + k, 71.0 + k, 72.0 + k)) for k in range(n))
    figures.bands([sets.SetBand("a", n, "kN", (60.0, 80.0, 100.0), {}, devices)], "sliding force (kN)")
    marks = drawn[0].axes[0].marks
    bar = next(y for x, y, _ in marks if tuple(x) == (60.0, 100.0))
    dots = [y for x, y, draw in marks if "form" in draw.keywords and x.size]
    heights = np.concatenate(dots)
    assert heights.size == n
    assert (len(dots) == 1) == crowded
    assert (np.abs(heights - bar[0]).min() > 0.2) == crowded
