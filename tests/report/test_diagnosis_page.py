"""The diagnosis page says what the files say, in words, and shows hostile names as text."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_diagnosis import made, record, write
from markupsafe import Markup
from page_tools import Page, check_safe, folded

from shj_bayes.app.device import diagnosis_text
from shj_bayes.errors import ReportError
from shj_bayes.report.diagnosis_page import draw, moves, render_diagnosis, signed_means
from shj_bayes.report.diagnosis_words import (
    VERDICTS,
    along_words,
    curve_words,
    fluctuation_words,
    over_words,
    per_cent,
    sentences,
    shape_columns,
    spaced,
    title_of,
    verdict_words,
)
from shj_bayes.report.page import kept_together
from shj_bayes.results.codec import from_json
from shj_bayes.results.device import DiagnosisData, read_diagnosis
from shj_bayes.results.diagnosis import DependenceRecord, DiagnosisRecord, DrawsInShort, Member, SetProbability, Shift


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, hostile_name: str) -> dict[str, Page]:
    root = tmp_path_factory.mktemp("diagnosis")
    return {v: Page(render_diagnosis(write(root / v, v, hostile_name))) for v in VERDICTS}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_renders_in_words(pages: dict[str, Page], verdict: str, hostile_name: str) -> None:
    page = pages[verdict]
    first = page.raw[: page.raw.index("<nav")]
    sign, colour, sentence = VERDICTS[verdict]
    assert f'<span class="badge {colour}">{sign} {verdict}</span>' in first
    assert sentence in first
    assert first.count("<img") == 2
    assert ("First look: intervals are approximate." in page.text) == (verdict == "adequate")
    assert ("it counts effects that may be there and were not found" in page.text) == (verdict == "adequate")
    check_safe(page)
    assert page.outside == []
    assert len(page.raw) < 3_000_000
    assert " ".join(hostile_name.split()) in page.text


def test_no_line_breaks_between_a_number_and_its_unit(pages: dict[str, Page]) -> None:
    gap = "\N{NO-BREAK SPACE}"
    assert f"falls by 15{gap}% at full stroke" in pages["named"].raw
    assert (
        kept_together("2 mm, 3 strokes of 4 kN: 5 % in 2 months")
        == f"2{gap}mm, 3 strokes of 4{gap}kN: 5{gap}% in 2 months"
    )
    assert kept_together(Markup("2 mm")) == "2 mm"  # code and data


def test_what_was_found_stands_open_and_the_rest_is_folded_away(pages: dict[str, Page]) -> None:
    later = ("Where the law fails", "Everything tried", "SHA-256", "cannot tell apart")
    assert [words for words in later if not folded(pages["named"], words)] == []
    first = ("What was left out", "What the omission did to the parameters", "Next test")
    assert [words for words in first if folded(pages["named"], words)] == []


def test_a_cause_is_told_as_surely_as_its_effect(pages: dict[str, Page]) -> None:
    first = {verdict: page.raw[: page.raw.index("<nav")] for verdict, page in pages.items()}
    assert ["Likely cause" in first[verdict] for verdict in ("named", "family", "unknown")] == [True, False, False]
    assert "If it is this, a likely cause:" in pages["family"].text


@pytest.mark.parametrize("n_cycles", [2, 3])
def test_two_cycles_that_show_nothing_do_not_show_that_all_is_well(
    tmp_path: Path, hostile_name: str, n_cycles: int
) -> None:
    folder = write(tmp_path, "adequate", hostile_name)
    told = record("adequate", hostile_name) | {
        "heldout": {"scheme": "x", "elpd_gain": 0.0, "se": 0.0, "n_blocks": n_cycles},
        "modelled": {},
    }
    (folder / "diagnosis.json").write_text(json.dumps(told), encoding="utf-8")
    page = Page(render_diagnosis(folder))
    for text in (page.text, diagnosis_text(from_json(DiagnosisRecord, told), folder / "diagnosis.html")):
        assert ("2 cycles are too few to say that nothing is missing" in text) == (n_cycles == 2)
        assert ("The model describes these recordings" in text) == (n_cycles == 3)


def test_numbers_are_those_of_the_record(pages: dict[str, Page]) -> None:
    page = pages["named"]
    exact = [attrs["value"] for attrs in page.all("data")]
    for value in (0.1512, 74.41, 80.12, 0.0159, 0.0003, 5.678, 123.4, -1.7):
        assert repr(value) in exact
    for text in ("3.33", "0.538", "below 0.001", "0.012", "up to 11.9 kN, 15 % of the sliding force", "97 %", "+123,"):
        assert text in page.text
    assert "Prying: the plates bend." in page.raw[: page.raw.index("<nav")]
    assert "dep has no bound" in page.text
    assert "dep between" in page.text
    assert "ab" * 32 in page.text


def test_family_and_unknown_say_their_own(pages: dict[str, Page]) -> None:
    family, unknown = pages["family"].text, pages["unknown"].text
    assert "61 %" in family
    assert "39 %" in family
    assert "Repeat one amplitude at a fifth of the speed." in family
    assert "17.3 mm of the position" in unknown
    assert "up to" not in unknown.partition("What no effect explains")[0]
    assert "4.32 kN" in unknown


def test_a_family_that_may_be_nothing_says_so() -> None:
    member, one = Member(id="drift", probability=0.92), SetProbability(classes=("added over time",), probability=0.92)
    held = replace(made("family"), effects=(), family=(member,), shift={}, sets=(one,), next_test=None)
    sure = verdict_words(held)[2]
    assert sentences(held) == [f"These recordings cannot tell: {title_of('drift').lower()} (92 %)."]
    same = Shift(before=DrawsInShort(mean=-4e-5, sd=1e-4), after=DrawsInShort(mean=4e-5, sd=1e-4))
    said = sentences(replace(held, modelled={"drift": {}}, shift={"gamma": same}))
    assert not any("gamma" in line for line in said)
    held = replace(held, sets=(one, SetProbability(classes=(), probability=0.08)))
    assert verdict_words(held)[2] != sure == VERDICTS["family"][2]
    assert sentences(held)[0].endswith("(92 %), or nothing of a size that matters (8 %).")


def test_the_scatter_of_an_unknown_misfit_is_not_called_noise(pages: dict[str, Page]) -> None:
    assert "This holds what no effect explains" in pages["unknown"].text
    assert "nothing is left to explain" not in pages["unknown"].text
    assert "nothing is left to explain" in pages["named"].text


def test_simulated_recordings_are_called_so(tmp_path: Path) -> None:
    folder = write(tmp_path, "named", "device")
    assert "Simulated data." not in Page(render_diagnosis(folder)).text
    (folder / "diagnosis.json").write_text(
        json.dumps(record("named", "device") | {"simulated": True}), encoding="utf-8"
    )
    assert "Simulated data." in Page(render_diagnosis(folder)).text


def test_every_mean_on_the_first_screen_has_its_spread(pages: dict[str, Page]) -> None:
    first = pages["adequate"].raw.partition("<nav")[0]
    assert "Spread 0.25." in first


def test_shape_of_the_unknown_is_drawn_along_the_motion(pages: dict[str, Page]) -> None:
    assert "counted along the motion" in pages["unknown"].text


@pytest.mark.parametrize(("text", "spaced_"), [("11% lower", "11 % lower"), ("100 % %d", "100 % %d")])
def test_per_cent_has_a_space_everywhere(text: str, spaced_: str) -> None:
    assert spaced(text) == spaced_


def test_aliases_are_words(pages: dict[str, Page]) -> None:
    text = pages["named"].text
    assert "“Clamping lost away from mid-stroke” looks like “" in text
    assert "the base law takes it up" in text


def test_nothing_found_shows_one_law(pages: dict[str, Page]) -> None:
    assert "with what was found" not in pages["adequate"].text
    assert "No effect was added to the law." in pages["adequate"].text


def test_profile_signs_along_the_motion() -> None:
    x = np.tile(np.linspace(0, 10, 100), 2)
    q = np.repeat([1, -1], 100)
    c = DiagnosisData(made("adequate"), x, x, x, x, x, q, np.ones_like(q), np.ones(200, dtype=bool), x, x, x)
    p = signed_means(c, 2.0 * q, {"position_mm": 5})
    assert p.push_kN == pytest.approx(2.0)
    assert p.pull_kN == pytest.approx(2.0)
    none = signed_means(c._replace(used=q > 0), 2.0 * q, {"position_mm": 5})
    assert np.isnan(none.pull_kN).all()


def test_sizes_and_shapes() -> None:
    assert per_cent(1.17) == "117"
    assert per_cent(0.0123) == "1.2"
    rows = [{"centre": x, "push_kN": 2 * x, "pull_kN": None} for x in (1, 2)]
    assert {name: v.tolist()[:2] for name, v in shape_columns(rows).items() if name != "pull_kN"} == {
        "centre": [1, 2],
        "push_kN": [2, 4],
    }
    assert shape_columns(rows[:1]) == shape_columns(()) == {}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.update(schema="other"), "schema"),
        (lambda r: r.update(verdict="sure"), "verdict"),
        (lambda r: r.pop("candidates"), "lacks candidates"),
        (lambda r: r.update(location=[{}]), r"location\[0\] lacks coordinate"),
    ],
)
def test_damaged_record_is_one_clear_error(tmp_path: Path, change: Any, message: str) -> None:
    folder = write(tmp_path, "named", "device")
    changed = record("named", "device")
    change(changed)
    (folder / "diagnosis.json").write_text(json.dumps(changed), encoding="utf-8")
    (folder / "diagnosis.html").write_text("old", encoding="utf-8")
    with pytest.raises(ReportError, match=message):
        render_diagnosis(folder)
    assert (folder / "diagnosis.html").read_text(encoding="utf-8") == "old"
    assert {p.name for p in folder.iterdir()} == {"diagnosis.html", "diagnosis.json", "diagnosis.nc"}


def test_missing_or_damaged_files(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"no diagnosis\.json"):
        render_diagnosis(tmp_path)
    folder = write(tmp_path / "a", "named", "device")
    (folder / "diagnosis.nc").write_bytes(b"not channels")
    with pytest.raises(ReportError, match="cannot be read"):
        render_diagnosis(folder)


def test_a_curve_of_push_over_time_is_known_while_the_device_pushes(tmp_path: Path) -> None:
    """Sine cycles of 20 pi s, two runs of six: pull is the middle half of each cycle."""
    at = np.linspace(0.0, 240.0 * np.pi, 97)
    band = {"at": at.tolist(), "mean": at.tolist(), "q05": at.tolist(), "q95": at.tolist(), "unit": "% of Fy"}
    row = {"coordinate": "time", "unit": "s", "action": "capacity", "period": None, "curve": band, "probability": 0.99}
    folder = write(tmp_path, "named", "device")
    changed = record("named", "device") | {"coordinates": [row | {"direction": side} for side in ("push", "pull")]}
    (folder / "diagnosis.json").write_text(json.dumps(changed), encoding="utf-8")
    data = read_diagnosis(folder)
    phase = (at / (20.0 * np.pi)) % 1.0
    away = np.abs((phase + 0.25) % 0.5 - 0.25) < 0.2  # from where it turns
    for side, moved in (("push", (phase <= 0.25) | (phase >= 0.75)), ("pull", (phase > 0.25) & (phase < 0.75))):
        known = moves(data, at, {"push": 1, "pull": -1}[side])
        assert np.array_equal(known[away], moved[away])
        assert 0 < known.sum() < known.size
    push, pull = (one["address"] for one in draw(data)["curves"])
    assert push != pull


def test_a_period_and_a_fluctuation_are_sentences() -> None:
    period = DependenceRecord(
        action="added", coordinate="time", unit="s", period=15.564, range_percent=3.86, probability=1.0
    )  # fmt: skip
    told = "An added force depends on the time: it changes by 3.9 % of Fy every 15.6 s, again and again."
    assert curve_words(period) == told
    row = replace(period, action="motion", coordinate="stick-slip", size_percent=23.4, matches=("stick_slip",))
    (told,) = fluctuation_words(replace(made("unknown"), coordinates=(row,)))
    assert told.startswith("The force fluctuates within a stroke by 23 % of the sliding force")
    assert fluctuation_words(replace(made("named"), coordinates=(row,))) == []
    (told,) = fluctuation_words(replace(made("unknown"), coordinates=(replace(row, size_percent=160.3),)))
    assert "by 160 % of the sliding force" in told


def test_a_chance_that_did_not_decide_is_not_told_beside_the_verdict(tmp_path: Path, hostile_name: str) -> None:
    folder = write(tmp_path, "unknown", hostile_name)
    why = "the force fluctuates within a stroke by more than noise can"
    for p, told in ((1.0, False), (1e-4, True)):
        changed = record("unknown", hostile_name) | {"p_value": p, "reason": why, "modelled": {}}
        (folder / "diagnosis.json").write_text(json.dumps(changed), encoding="utf-8")
        page = Page(render_diagnosis(folder))
        first = diagnosis_text(from_json(DiagnosisRecord, changed), folder / "diagnosis.html").splitlines()[0]
        assert ("if nothing were missing" in page.text) == ("if nothing were missing" in first) == told
        assert (why in first) != told


def test_what_is_not_determined_and_what_does_not_carry_over_is_said(tmp_path: Path) -> None:
    changed = record("named", "seal") | {"modelled": {}}
    changed["modelled"] = {"prying": {"size": 0.15}}
    changed["shift"] = {
        "Fy": {"before": {"mean": 0.0053, "sd": 0.0002}, "after": {"mean": 0.0046, "sd": 0.0003}},
        "K": {"before": {"mean": 5e5, "sd": 1.6e7}, "after": {"mean": 0.12, "sd": 0.02}},
    }
    changed["after"] = changed["after"] | {"heldout_rmse_kN": 33.34}
    changed["heldout"] = changed["heldout"] | {"elpd_gain": -76.0}
    folder = write(tmp_path, "named", "seal")
    (folder / "diagnosis.json").write_text(json.dumps(changed), encoding="utf-8")
    told = diagnosis_text(from_json(DiagnosisRecord, changed), folder / "diagnosis.html")
    page = Page(render_diagnosis(folder)).text
    (stiffness,) = [line for line in told.splitlines() if line.startswith("  K ")]
    assert "not determined" in stiffness
    assert stiffness.endswith("N/mm")
    assert "5.3 +-" in told  # newtons, as on the page of the fit
    assert "does not carry over" in told
    assert all(words in page for words in ("not determined", "does not carry over", "predictions are worse"))
    assert "500000" not in page


def test_forces_of_a_small_device_are_in_newtons(tmp_path: Path) -> None:
    page = Page(render_diagnosis(write(tmp_path / "small", "named", "seal", scale=1e-4)))
    shown = page.text.replace("The misfit reaches 4.3 kN", "")
    assert not re.search(r"\d kN\b|e-\d\d N|\(kN\)", shown)
    assert "The base law misses the force by 0.322 N in root mean square" in shown
    assert "up to 1.19 N, 15 % of the sliding force" in shown
    viewer = page.raw.partition('<script type="application/json" id="loops-data">')[2].partition("</script>")[0]
    assert json.loads(viewer)["unit"] == "N"


def test_a_speed_coefficient_that_changes_is_said_of_the_speed_and_drawn_along_the_distance() -> None:
    assert over_words("speed_by_travel") == "the speed, in a way that changes with the distance slid"
    assert along_words("speed_by_travel") == "the distance slid, at peak speed"
    assert over_words("heat") == along_words("heat") == "the heat that sliding has left"
    assert title_of("speed_by_travel") == f"Sliding force follows {over_words('speed_by_travel')}"
