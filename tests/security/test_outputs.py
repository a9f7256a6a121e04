"""What goes out is text, whatever came in: pages, tables, folders; and results that were altered are said to be."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from shj_bayes.campaign import Device, read_manifest
from shj_bayes.errors import InferenceError, ReportError
from shj_bayes.files import folder_name, plain_name
from shj_bayes.inference import store
from shj_bayes.pipeline import Options
from shj_bayes.population.results import safe_cell
from shj_bayes.report.campaign import render_campaign, safe_folder
from shj_bayes.report.device import render_device

ANYWHERE = re.compile(
    r"""(?:src|href|action|data|poster|background)\s*=\s*["']?\s*(?!data:|#)(?:[a-z]+:)?//|url\((?!["']?(?:data:|#))|@import""",
    re.I,
)
NAMES = (
    "../../etc/passwd",
    "..",
    ".",
    "CON",
    "a/b\\c",
    "\x00",
    "\u202egnp",
    "=cmd|' /C calc'!A0",
    "<b>",
    "x" * 500,
    "\ud800",
)


@pytest.fixture
def copy(fitted, tmp_path):
    """A copy of the fit that a test may change."""
    return Path(shutil.copytree(fitted, tmp_path / "copy"))


def policy_of(page: str) -> str:
    found = re.search(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert found
    return found[1]


def test_pages_carry_a_policy_and_load_nothing(copy):
    page = render_device(copy).read_text(encoding="utf-8")
    policy = policy_of(page)
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy
    assert not re.search(r"script-src[^;]*unsafe-inline", policy)
    assert not re.search(r"https?:|\*", policy)
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", page, re.DOTALL)
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon|import\(|eval\(", " ".join(scripts))
    body = re.sub(r"data:[^\"')]*", "data:", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL))
    assert not ANYWHERE.search(body)
    assert page.index("Content-Security-Policy") < page.index("<style")  # it governs what stands behind it


def test_every_page_template_has_the_policy():
    folder = Path(store.__file__).parents[1] / "report" / "templates"
    base = (folder / "base.html").read_text(encoding="utf-8")
    assert "Content-Security-Policy" in base
    whole = [p for p in folder.glob("*.html") if "<html" in p.read_text(encoding="utf-8")]
    assert [p.name for p in whole] == ["base.html"]
    assert not any("|safe" in p.read_text(encoding="utf-8").replace(" ", "") for p in folder.glob("*.html"))


def test_hostile_names_are_text_on_the_page(copy, hostile):
    page = render_device(copy).read_text(encoding="utf-8")
    assert "<script>alert(" not in page
    assert "&lt;script&gt;alert(" in page
    assert "{{ 7*7 }}" in page  # not 49: a name is never a template


@pytest.mark.parametrize("name", NAMES)
def test_folders_of_devices_stay_below_the_campaign(tmp_path, name):
    slug = folder_name(name)
    assert re.fullmatch(r"[a-z0-9][a-z0-9.-]*", slug)
    assert len(slug) < 80
    folder = (tmp_path / Device(name, name, (), Options()).folder).resolve()
    assert folder.is_relative_to(tmp_path / "devices")
    assert folder != tmp_path / "devices"
    shown = plain_name(name)
    assert shown.isprintable()
    shown.encode("utf-8")


def test_a_campaign_record_cannot_lead_elsewhere(tmp_path):
    for place in ("../secret", "/etc", "devices/../../x", "a//b", "C:\\x", "devices/..", "", "x\n"):
        assert not safe_folder(place), place
    devices = [{"name": "<b>", "folder": "../../etc", "status": "done", "reason": "<script>", "verdict": "reliable"}]
    record = {"name": "<i>", "sets": [{"name": "=1+1", "devices": devices}]}
    (tmp_path / "campaign.json").write_text(json.dumps(record), encoding="utf-8")
    page = render_campaign(tmp_path).read_text(encoding="utf-8")
    assert "../../etc" not in page
    assert not re.search(r"<(b|i|script)>(alert|</)", page)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+1", "@SUM(A1)", " =1", "\t=1", "\r=1", "\n=1"])
def test_formulas_are_neutral_in_tables(text):
    assert str(safe_cell(text)).startswith("'")
    assert safe_cell("Zinc 70") == "Zinc 70"
    assert safe_cell(-1.5) == -1.5


def test_no_cell_of_a_written_table_is_a_formula(copy):
    with (copy / "summary.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.reader(stream):
            for cell in row:
                assert not cell.startswith(("=", "@", "\t", "\r"))
                if cell.startswith(("+", "-")):
                    float(cell)


def test_names_in_manifests_are_cleaned(tmp_path):
    path = tmp_path / "campaign.toml"
    text = 'schema = "shj-bayes/campaign/1"\n[[set]]\nname = "a\\u001B[2J\\u202Eb"\n[[set.device]]\nname = "\\u0000"\n'
    path.write_text(text + 'recordings = ["r.csv"]\n', encoding="utf-8")
    device = read_manifest(path).devices[0]
    assert device.set_name.isprintable()
    assert device.name == "device"


# ---- altered results ----


@pytest.mark.parametrize("name", ["posterior.nc", "summary.csv", "summary.json"])
@pytest.mark.parametrize("change", ["cut", "bit", "gone"])
def test_altered_files_of_a_fit_are_named(copy, name, change):
    path = copy / name
    raw = bytearray(path.read_bytes())
    if change == "gone":
        path.unlink()
    elif change == "cut":
        path.write_bytes(raw[:-1])
    else:
        raw[len(raw) // 2] ^= 1
        path.write_bytes(raw)
    with pytest.raises(InferenceError, match=rf"{name} (is missing in|in .* was cut short or altered)"):
        store.check_files(copy, store.read_record(copy))
    with pytest.raises((InferenceError, ReportError), match=name):
        render_device(copy)


def test_an_altered_record_is_told(copy):
    path = copy / "fit.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    record["parameters"][0]["mean"] *= 1.01
    path.write_text(json.dumps(record, indent=1), encoding="utf-8")
    with pytest.raises(
        InferenceError, match=r"fit\.json in .* was altered after it was written .* run the command again"
    ):
        store.read_record(copy)


def test_a_record_that_is_only_laid_out_anew_is_the_same(copy):
    path = copy / "fit.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8"))), encoding="utf-8")
    store.check_files(copy, store.read_record(copy))
