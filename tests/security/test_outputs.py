"""What goes out is text, whatever came in: pages, tables, folders; and results that were altered are said to be."""

import csv
import io
import json
import re
import shutil
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from made_diagnosis import made

import shj_bayes
from shj_bayes._util import processes
from shj_bayes._util.files import check_seal, file_digest, folder_name, plain_name, read_json, sealed
from shj_bayes.app.manifest import Device, read_manifest
from shj_bayes.app.resume import design_margins
from shj_bayes.cli import Output
from shj_bayes.errors import InferenceError, PopulationError, ReportError, ShjError
from shj_bayes.inference import store
from shj_bayes.margins.specimen import read_specimen
from shj_bayes.mismatch.diagnosis import DiagnosisResult
from shj_bayes.options import FitOptions
from shj_bayes.population.device import published_devices
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.results import load_population, write_population
from shj_bayes.report.campaign import render_campaign
from shj_bayes.report.device import render_device
from shj_bayes.report.diagnosis_page import render_diagnosis
from shj_bayes.results import device as device_file
from shj_bayes.results import store as store_file
from shj_bayes.results.campaign import safe_folder
from shj_bayes.results.codec import to_json
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.tables import safe_cell

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
    folder = (tmp_path / Device(name, name, (), FitOptions()).folder).resolve()
    assert folder.is_relative_to(tmp_path / "devices")
    assert folder != tmp_path / "devices"
    shown = plain_name(name)
    assert shown.isprintable()
    shown.encode("utf-8")


def campaign_of(folder, place):
    """Write a sealed record of a campaign with one device."""
    device = {"name": "<b>", "folder": place, "status": "done", "reason": "<script>", "verdict": "reliable"}
    record = sealed({"schema": "shj-bayes/campaign/1", "name": "<i>", "sets": [{"name": "=1+1", "devices": [device]}]})
    (folder / "campaign.json").write_text(json.dumps(record), encoding="utf-8")


@pytest.fixture(scope="module")
def pooled(tmp_path_factory):
    """A folder with a fitted population and without a campaign."""
    folder = tmp_path_factory.mktemp("pooled")
    write_population(fit_population(published_devices()[:4], seed=1), folder)
    return folder


@pytest.mark.parametrize(
    "place", ["../../..", "/etc", "devices/../../x", "link/x", "loop", "C:\\x", "x\n", "", 5, None]
)
def test_device_folders_stay_inside_the_campaigns(pooled, tmp_path, place):
    folder = Path(shutil.copytree(pooled, tmp_path / "spring"))
    (folder / "link").symlink_to(tmp_path)
    (folder / "loop").symlink_to("../loop")
    campaign_of(folder, place)
    words = (
        r"names the folder .* for the device '<b>' of the set '=1\+1'; it must be one below spring|it must be a text"
    )
    for reader in (render_campaign, shj_bayes.load, design_margins):
        with pytest.raises(ReportError, match=words):
            reader(folder)
    assert safe_folder(str(place)) == (place in ("link/x", "loop", 5, None))


def test_names_in_a_campaign_are_text_on_its_page(tmp_path):
    campaign_of(tmp_path, "devices/x")
    page = render_campaign(tmp_path).read_text(encoding="utf-8")
    assert not re.search(r"<(b|i|script)>(alert|</)", page)
    assert "&lt;b&gt;" in page


@pytest.mark.parametrize("key", ["effects", "family", "location", "shift", "aliases", "candidates", "coordinates"])
@pytest.mark.parametrize("value", [5, None, "x", [5], {"a": 5}])
def test_fields_of_a_diagnosis_that_are_of_another_kind_are_named(tmp_path, key, value):
    record = to_json(made("adequate")) | {
        "effects": [],
        "family": [],
        "location": [],
        "shift": {},
        "aliases": [],
        "candidates": [],
        "coordinates": [],
    }
    (tmp_path / "diagnosis.json").write_text(json.dumps(record), encoding="utf-8")
    assert shj_bayes.load(tmp_path).effects == ()
    (tmp_path / "diagnosis.json").write_text(json.dumps(record | {key: value}), encoding="utf-8")
    for reader in (shj_bayes.load, render_diagnosis):
        with pytest.raises(ReportError, match=rf"diagnosis\.json in .*: {key}\S* is .*; it must be a (list|table)"):
            reader(tmp_path)


FORMULAS = ("=1+1", "+1", "-1+1", "@SUM(A1)", " =1", "\t=1", "\r=1", "\n=1")
WIDE = ("\uff1d1", " \uff0b1", "\uff0d1", "\uff20A", "\ufe661", "\u22121")


@pytest.mark.parametrize("text", FORMULAS + WIDE)
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


@pytest.mark.parametrize("content", [[1, 2], {"name": "x", "sets": 5}, {"name": "x", "sets": [{"name": "a"}]}])
@pytest.mark.parametrize("more", [{}, {"together": 5}, {"together": [5]}, {"warnings": 5}])
def test_a_campaign_that_holds_something_else_is_one_line(tmp_path, content, more):
    content = content | more if isinstance(content, dict) else content
    if more:
        content = {"name": "x", "sets": [], **more}
    if isinstance(content, dict):
        content["schema"] = "shj-bayes/campaign/1"
    (tmp_path / "campaign.json").write_text(json.dumps(content), encoding="utf-8")
    for reader in (render_campaign, shj_bayes.load):
        with pytest.raises(ReportError, match=r"campaign\.json in .*; restore it, or run shj-bayes campaign again"):
            reader(tmp_path)


STEERING = "Zinc\x1b]0;owned\x07\x1b[2J \u202e70\x7f\x9b31m"


def test_stored_texts_do_not_steer_the_terminal_and_stay_sealed(tmp_path):
    record = {"schema": "shj-bayes/made/1", "stages": {STEERING: [STEERING, {"said": f"a\nb{STEERING}"}]}}
    for ascii_only in (True, False):
        (tmp_path / "x.json").write_text(json.dumps(sealed(record), ensure_ascii=ascii_only), encoding="utf-8")
        read = read_json(tmp_path / "x.json", ShjError)
        check_seal(read, tmp_path / "x.json", ShjError)
        ((name, (first, said)),) = read["stages"].items()
        assert name.isprintable()
        assert first.isprintable()
        assert all(line.isprintable() for line in said["said"].split("\n"))
        assert said["said"].count("\n") == 1
        (tmp_path / "x.json").write_text(
            json.dumps(sealed(record) | {"more": 1}, ensure_ascii=ascii_only), encoding="utf-8"
        )
        with pytest.raises(ShjError, match="altered"):
            check_seal(read_json(tmp_path / "x.json", ShjError), tmp_path / "x.json", ShjError)


def test_nothing_that_is_printed_steers_the_terminal(capsys):
    Output().show({}, f"a\n{STEERING}")
    Output().tell(STEERING)
    said = capsys.readouterr()
    assert said.out.count("\n") == 2
    assert all(line.isprintable() for line in (said.out + said.err).split("\n"))


def archive(path, kind):
    """A foreign archive of draws; all but one as `np.savez` would not write it."""
    if kind == "packed":
        np.savez_compressed(path, **{"default/Fy/mu": np.zeros(2_000_000)})
        return
    head = io.BytesIO()
    shape = (10**9, 10**3) if kind == "claims" else (10,)
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(path, "w") as out:
        for number in range(2):
            out.writestr(f"default/Fy/{number}.npy", head.getvalue() + bytes(80))
    raw = path.read_bytes()
    at = {"directory": raw.index(b"PK\x01\x02") + 24, "place": raw.index(b"PK\x05\x06") + 16}.get(kind)
    if at is not None:
        path.write_bytes(raw[:at] + (2**31).to_bytes(4, "little") + raw[at + 4 :])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        *[(kind, "would unpack to more than it holds") for kind in ("packed", "claims", "directory")],
        ("place", "holds something else"),
    ],
)
def test_draws_that_unpack_to_more_than_they_hold_are_refused(pooled, tmp_path, kind, words):
    folder = Path(shutil.copytree(pooled, tmp_path / "spring"))
    archive(folder / "population.npz", kind)
    record = json.loads((folder / "population.json").read_text(encoding="utf-8"))
    record["draws_sha256"] = file_digest(folder / "population.npz")
    (folder / "population.json").write_text(json.dumps(sealed(record)), encoding="utf-8")
    with pytest.raises(PopulationError, match=rf"population\.npz in spring .*{words}"):
        load_population(folder)


# ---- altered results ----


def window(file, other, kind):
    """Put a window into another file in the place of a dataset, or of a group."""
    name = "posterior" if kind == "group" else "posterior/Fy"
    shape = file["posterior/Fy"].shape
    file.move(name, "kept")
    if kind in ("group", "external link"):
        file[name] = h5py.ExternalLink(other, name)
    elif kind == "soft link":
        file[name] = h5py.SoftLink("/kept")
    elif kind == "external":
        file.create_dataset(name, shape, "f8", external=[(str(other), 0, 8 * shape[0] * shape[1])])
    else:
        layout = h5py.VirtualLayout(shape, "f8")
        layout[:] = h5py.VirtualSource(other, name, shape)
        file.create_virtual_dataset(name, layout)


def reseal(folder):
    record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    record["files"]["posterior.nc"] = file_digest(folder / "posterior.nc")
    (folder / "fit.json").write_text(json.dumps(sealed(record)), encoding="utf-8")


@pytest.mark.parametrize("kind", ["group", "external link", "soft link", "external", "virtual"])
def test_a_posterior_that_is_a_window_into_another_file_is_refused(copy, fitted, kind):
    with h5py.File(copy / "posterior.nc", "a") as file:
        window(file, fitted / "posterior.nc", kind)
    reseal(copy)
    for reader in (lambda folder: device_file.read_group(folder, "posterior"), render_device):
        with pytest.raises(InferenceError, match="is a link to somewhere else, or lies there"):
            reader(copy)


def hostile(file, kind):
    """Put what no fit writes, and what the library cannot bear, into a posterior."""
    if kind == "deep":
        file.create_group("posterior/" + "g/" * 5000)
    elif kind == "many":
        for number in range(2001):
            file.create_group(f"posterior/{number}")
    elif kind == "claimed":
        file.create_dataset("posterior/a", (10**12,), "f8", chunks=(1000,))
    else:  # a chunk of 8 KB that unpacks to 1.7 GB
        one = file.create_dataset("posterior/a", (1000,), "f8", chunks=(1000,), compression="gzip")
        packer = zlib.compressobj()
        piece, again = (packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
        one.id.write_direct_chunk((0,), piece + 99 * again + packer.flush())


@pytest.mark.parametrize("kind", ["deep", "many", "claimed", "chunk"])
def test_a_posterior_that_is_none_is_refused_before_it_is_read_here(copy, kind):
    with h5py.File(copy / "posterior.nc", "a") as file:
        hostile(file, kind)
    reseal(copy)
    with pytest.raises(InferenceError, match=r"posterior\.nc in copy cannot be read \(.*\); run the fit again"):
        device_file.read_group(copy, "posterior")
    if kind in ("claimed", "chunk"):
        assert set(device_file.read_group(copy, "observed_data")) > {"half_cycle"}


@pytest.mark.parametrize("body", ["import os; os.abort()", "import sys, os; sys.stdin.readline(); os.abort()"])
def test_a_posterior_that_ends_the_library_is_one_line_and_the_next_one_is_read(fitted, monkeypatch, body):
    processes._end()
    monkeypatch.setattr(store_file, "_TRUSTED", set())  # as in a process that did not make the fit
    with monkeypatch.context() as changed:
        changed.setattr(processes, "_CHILD", body)
        with pytest.raises(InferenceError, match=r"posterior\.nc in .* cannot be read \(.* gave up\)"):
            device_file.read_group(fitted, "posterior")
    assert "Fy" in device_file.read_group(fitted, "posterior")
    one = processes._child().pid
    assert "Fy" in device_file.read_group(fitted, "prior")
    assert processes._child().pid == one  # one process for all files


def test_the_fit_of_another_device_is_not_taken_for_this_one(fitted):
    name = store_file.read(FitRecord, fitted).device
    assert read_specimen(fitted, name, "bare").name == name
    with pytest.raises(PopulationError, match="not of 'other'; put the folders of the devices back"):
        read_specimen(fitted, "other", "bare")


def test_a_diagnosis_is_not_written_through_a_link_and_its_old_page_goes(tmp_path):
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    (tmp_path / "diagnosis.nc.part").symlink_to(tmp_path / "mine")
    (tmp_path / "diagnosis.html").write_text("of the one before", encoding="utf-8")
    DiagnosisResult(made("adequate"), xr.Dataset({"force": ("point", np.arange(3.0))})).write(tmp_path)
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / "diagnosis.html").exists()


def test_what_this_process_wrote_or_vetted_is_trusted_until_it_is_altered(copy, monkeypatch):
    asked = []
    monkeypatch.setattr(store_file, "vet", lambda path, group: asked.append(group))
    monkeypatch.setattr(store_file, "_TRUSTED", {(file_digest(copy / "posterior.nc"), "")})
    device_file.read_group(copy, "posterior")
    assert not asked
    with h5py.File(copy / "posterior.nc", "a") as file:
        file.attrs["device"] = "another"
    reseal(copy)
    for group in ("posterior", "posterior", "prior", "prior"):
        device_file.read_group(copy, group)
    assert asked == ["posterior", "prior"]


def test_what_a_fit_writes_is_no_window(fitted):
    processes.vet(fitted / "posterior.nc")


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
        store_file.check_files(copy, store_file.read(FitRecord, copy))
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
        store_file.read(FitRecord, copy)


def test_a_record_that_is_only_laid_out_anew_is_the_same(copy):
    path = copy / "fit.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8"))), encoding="utf-8")
    store_file.check_files(copy, store_file.read(FitRecord, copy))
