"""What sets have in common: sentences from values, the table, and pages that stay whole and safe."""

import json
from pathlib import Path

import pytest
from made_campaign import make_campaign, population
from made_diagnosis import made
from page_tools import Page, check_safe

from shj_bayes.errors import ReportError
from shj_bayes.report.campaign import render_campaign
from shj_bayes.report.campaign_physics import statements, table
from shj_bayes.results.campaign import SetTogether, read_campaign
from shj_bayes.results.codec import from_json
from shj_bayes.results.store import write

FOLDERS = [f"devices/d{i}" for i in range(4)]
WEAR = {
    "action": "capacity",
    "coordinate": "travel",
    "unit": "m",
    "probability": 0.981,
    "enters": True,
    "rivals": [],
    "of_devices": [0.97, 0.99, 0.96, 0.2],
    "alone": [False, True, False, False],
    "effects": ["capacity_over_travel_50_02"] * 4,
    "size_percent": [0.8, 1.6, 1.1, 0.0],
    "change_percent": [-2.0, -4.0, -2.6, 0.1],
}


def group(*classes, name="bare", folders=FOLDERS):
    """What a set has in common, as it stands in the file."""
    return {"set": name, "devices": list(folders), "classes": list(classes)}


def record(*classes, **change):
    """What a set has in common, as it is read."""
    return [from_json(SetTogether, group(*classes, **change))]


def test_a_loss_of_force_is_said_with_its_size_and_who_shows_it():
    assert statements(record(WEAR)) == (
        "Three of four devices of set bare lose sliding force with the distance slid: 2 to 4 % of Fy over "
        "what was tested (probability 98 %; one shows it alone).",
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"change_percent": [2.0, 4.0, 2.6, 0.1]}, "gain sliding force with the distance slid: 2 to 4 %"),
        ({"change_percent": [2.0, -4.0, 2.6, 0.1]}, "that depends on the distance slid: 0.8 to 1.6 %"),
        ({"change_percent": [None] * 4}, "have a sliding force that depends on"),
        ({"rivals": ["capacity over time"]}, "Their tests do not tell it from sliding force over the time."),
        ({"alone": [True] * 4}, "each shows it alone"),
        ({"alone": [False] * 4}, "none shows it alone"),
        ({"alone": [True, True, False, False]}, "two show it alone"),
        ({"size_percent": [0.2, 0.3, 0.4, 0.0]}, "In none of them can more than 1 % of Fy be seen"),
        ({"action": "motion", "coordinate": "slack"}, "show a clearance: up to 0.8 to 1.6 % of Fy"),
        ({"action": "added", "coordinate": "constant"}, "show a constant force beside friction: up to"),
    ],
)  # fmt: skip
def test_other_sentences(change, words):
    (said,) = statements(record(WEAR | change))
    assert words in said


def test_what_is_not_certain_is_not_said_and_nothing_in_common_is():
    nothing = ("Nothing beyond the law is certain to be common to the devices of set bare.",)
    assert statements(record(WEAR | {"probability": 0.6, "enters": False})) == nothing
    assert statements(record(folders=["devices/d0"])) == ()
    lone = {key: value[:1] if isinstance(value, list) else value for key, value in WEAR.items()}
    assert statements(record(lone, folders=FOLDERS[:1])) == ()
    assert statements(()) == ()
    assert table(()) is None


def test_the_table_holds_what_is_not_excluded():
    other = WEAR | {"coordinate": "speed", "probability": 0.01, "alone": [False] * 4, "enters": False}
    content = table(record(WEAR, other))
    assert content["sets"] == [{"name": "bare", "n": 4}]
    assert [c["words"] for c in content["classes"]] == ["sliding force over the distance slid"]
    cell = content["classes"][0]["cells"][0]
    assert (len(cell.holders), len(cell.of_devices), sum(cell.alone)) == (3, 4, 1)
    assert content["excluded"] == {"Sliding force": ["the speed"]}


@pytest.mark.parametrize(
    "change",
    [
        {"alone": [True]},
        {"probability": "many"},
        {"of_devices": None},
        {"size_percent": [[]] * 4},
    ],
)
def test_damage_is_one_clear_error(change, tmp_path):
    for told in (group(WEAR | change), group(WEAR, folders=["../../etc", *FOLDERS[1:]])):
        content = {"schema": "shj-bayes/campaign/1", "name": "c", "sets": [], "together": [told]}
        (tmp_path / "campaign.json").write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(ReportError, match=r"campaign\.json in .*; restore it, or run"):
            read_campaign(tmp_path)


def test_the_page_says_it_and_stays_safe(tmp_path: Path, fitted: Path, hostile_name: str) -> None:
    root = make_campaign(tmp_path, fitted, hostile_name)
    path = root / "campaign.json"
    held = json.loads(path.read_text(encoding="utf-8"))
    places = [d["folder"] for group in held["sets"] for d in group["devices"]]
    held["together"] = [group(WEAR, name=hostile_name, folders=places)]
    held["sets"][0]["devices"][0] |= {"diagnosis": "adequate", "with_set": "reliable", "diagnosis_reason": ""}
    path.write_text(json.dumps(held), encoding="utf-8")
    page = Page(render_campaign(root, population((hostile_name, "other"))))
    check_safe(page)
    assert "What sets have in common" in page.text
    assert "lose sliding force with the distance slid: 2 to 4 % of Fy" in page.text
    assert "with its set: reliable" in page.text


def test_curves_of_a_diagnosis_are_drawn(tmp_path: Path, fitted: Path) -> None:
    root = make_campaign(tmp_path, fitted, "bare")
    path = root / "campaign.json"
    held = json.loads(path.read_text(encoding="utf-8"))
    places = [d["folder"] for group in held["sets"] for d in group["devices"]]
    held["together"] = [group(WEAR, folders=places)]
    path.write_text(json.dumps(held), encoding="utf-8")
    curve = {"at": [0.0, 1.0], "mean": [0.0, -3.0], "q05": [-0.1, -4.0], "q95": [0.1, -2.0], "unit": "% of Fy"}
    rows = [{"action": "capacity", "coordinate": "travel", "unit": "m", "probability": 1.0, "curve": curve}]
    (root / places[0] / "diagnosis").mkdir()
    write(made("named", coordinates=rows), root / places[0] / "diagnosis")
    page = Page(render_campaign(root))
    check_safe(page)
    assert "Change of the sliding force over the distance slid" in page.text
    assert any("for each device of the devices of set bare" in a.get("alt", "") for a in page.all("img"))
