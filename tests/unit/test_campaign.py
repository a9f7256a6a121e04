"""Campaigns: one bad device never stops the rest, a second call does only what is missing or changed."""

import importlib
import json
import re
import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from shj_bayes._util.files import folder_name, shipped
from shj_bayes.app.campaign import run_campaign, summarise_campaign, summarise_tables
from shj_bayes.app.design import compare_sets
from shj_bayes.app.manifest import read_manifest
from shj_bayes.cli import main
from shj_bayes.errors import CampaignError
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv
from shj_bayes.results.campaign import read_campaign

pytestmark = pytest.mark.usefixtures("brief_workbooks")
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
HEAD = 'schema = "shj-bayes/campaign/1"\nname = "small"\n[defaults]\nmax_steps = 60\n'
CONNECTION = 'bolts = 2\nbolt_mm = 16\nsurfaces = 2\nclamping_kN = 95.5\nslot_mm = 220\nshim = "Bisalloy 500"'


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Three devices in two sets, one of them with a broken recording, run once."""
    folder = tmp_path_factory.mktemp("campaign")
    text = HEAD
    for number, (set_name, capacity) in enumerate((("bare", 80.0), ("bare", 85.0), ("coated <b>", 60.0)), start=1):
        runs = simulate_device(Truth(Fy=capacity, phi=0.3), seed=number, rate_Hz=4.0, blocks=BLOCKS)
        names = [write_csv(folder / f"d{number}-{i}.csv", r).name for i, r in enumerate(runs, start=1)]
        if number != 2:
            text += f'[[set]]\nname = "{set_name}"\n'
        if number == 3:
            text += f"[set.connection]\n{CONNECTION}\n"
        text += f'[[set.device]]\nname = "device {number}"\nrecordings = {json.dumps(names)}\n'
    (folder / "broken.csv").write_text("time_s,force_kN\n1,2\n2,3\n3,4\n", encoding="utf-8")
    text += '[[set.device]]\nname = "../../broken"\nrecordings = ["broken.csv"]\n'
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    manifest = read_manifest(path)
    return manifest, folder / "out", run_campaign(manifest, folder / "out", workers=2, diagnose="off")


def test_good_devices_are_done_and_the_bad_one_is_named(campaign):
    manifest, out, outcomes = campaign
    assert [o.status for o in outcomes] == ["done", "done", "done", "failed"]
    assert "displacement" in outcomes[3].reason
    assert {p.name for p in out.iterdir()} == {"devices", "campaign.json"}
    assert not list(out.parent.parent.glob("broken*/fit.json"))
    record = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    assert [s["name"] for s in record["sets"]] == ["bare", "coated <b>"]
    assert "connection" not in record["sets"][0]
    said = {"bolts": 2, "bolt_mm": 16, "surfaces": 2, "clamping_kN": 95.5, "slot_mm": 220, "shim": "Bisalloy 500"}
    assert record["sets"][1]["connection"] == said
    assert read_campaign(out).sets[1].connection.travel_mm == 102
    assert len(manifest.devices) == 4


def test_second_call_keeps_what_is_unchanged(campaign):
    manifest, out, _ = campaign
    stamps = {p: p.stat().st_mtime_ns for p in out.glob("devices/*/posterior.nc")}
    assert [o.status for o in run_campaign(manifest, out, workers=1, diagnose="off")] == [
        "kept",
        "kept",
        "kept",
        "failed",
    ]
    assert {p: p.stat().st_mtime_ns for p in out.glob("devices/*/posterior.nc")} == stamps


def test_summary_pools_compares_and_writes_a_page(campaign):
    _, out, outcomes = campaign
    result = summarise_campaign(outcomes, out, seed=1)
    assert result.usable
    assert "failed" in result.text
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "coated &lt;b&gt;" in page
    assert "<b>" not in page.replace("coated &lt;b&gt;", "")
    assert (out / "population.csv").exists()
    record, text = compare_sets(out, "bare", "coated <b>")
    force = next(row for row in record["contrasts"] if row["quantity"] == "Fy")
    assert force["q50"] == pytest.approx(82.5 / 60, rel=0.15)
    assert "no effect" not in text


def _alter(path, old="", new=" "):
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")


@pytest.mark.parametrize(
    ("changed", "touched"),
    [
        ({"name": "another"}, None),
        ({"simulated": True}, None),
        ({"devices": slice(1, 3)}, None),
        ({"devices": slice(0, 4)}, None),  # the broken one is new
        ({"tags": Tags(corroded=True)}, None),
        ({"seed": 2}, None),
        ({"package": "another"}, None),
        ({}, lambda out: _alter(out / "report.html")),
        ({}, lambda out: (out / "margins.html").unlink()),
        ({}, lambda out: _alter(out / "loops.csv")),  # left by another command: it must not stay unnoticed either
        ({}, lambda out: _alter(next(out.glob("devices/*/residual.json")))),
        ({}, lambda out: _alter(out / "made.json", "bands", "lies")),
    ],
)
def test_a_summary_stands_until_something_that_it_rests_on_or_wrote_changes(
    campaign, tmp_path, monkeypatch, changed, touched
):
    manifest, out, _ = campaign
    out = Path(shutil.copytree(out, tmp_path / "out"))
    (out / "loops.csv").write_text("old", encoding="utf-8")
    calls = []

    def pooled(usable, folder, **_options):
        calls.append(len(usable))
        for name in ("report.html", "margins.html"):
            (folder / name).write_text("a page", encoding="utf-8")
        return {"record": {"population": 1.5}, "lines": ["bands"]}

    monkeypatch.setattr("shj_bayes.app.design.pooled_campaign", pooled)

    def run(devices=slice(0, 3), tags=NO_TAGS, seed=1, package="one", **more):
        monkeypatch.setattr("shj_bayes.results.store.package", lambda: package)
        chosen = tuple(replace(device, tags=tags) for device in manifest.devices[devices])
        given = manifest._replace(devices=chosen, **more)
        return summarise_campaign(run_campaign(given, out, workers=1, diagnose="off"), out, seed=seed)

    first, again = run(), run()
    assert len(calls) == 1
    assert (again.text, again.record) == (first.text, first.record)
    if touched:
        touched(out)
    run(**changed)
    assert len(calls) == 2
    assert {(out / name).read_text(encoding="utf-8") for name in ("report.html", "margins.html")} == {"a page"}


def test_unchanged_tables_are_kept(tmp_path, monkeypatch):
    made = []
    said = {"record": {"schema": "made up"}, "lines": ["bands"]}
    monkeypatch.setattr("shj_bayes.app.design.pooled_tables", lambda *_, seed, **__: made.append(seed) or said)
    first, again = (summarise_tables(tmp_path, (), seed=1) for _ in range(2))
    assert made == [1]
    assert (first.record, first.text) == (again.record, again.text)
    (tmp_path / "report.html").write_text("altered", encoding="utf-8")
    summarise_tables(tmp_path, (), seed=1)
    summarise_tables(tmp_path, (), seed=2)
    assert made == [1, 1, 2]


def test_a_page_made_again_needs_no_new_draws(campaign, monkeypatch):
    """A page that is gone is written as before from the population that stands; other devices are pooled anew."""
    manifest, out, _ = campaign
    outcomes = run_campaign(manifest, out, workers=1, diagnose="off")
    first = summarise_campaign(outcomes, out, seed=1)
    pages = {path: path.read_bytes() for path in (out / "report.html", out / "margins.html")}
    (out / "report.html").unlink()

    def never(*_given, **_options):
        raise AssertionError("pooled again")

    monkeypatch.setattr("shj_bayes.app.design.fit_population", never)
    again = summarise_campaign(outcomes, out, seed=1)
    assert {path: path.read_bytes() for path in pages} == pages
    assert again.record == first.record
    with pytest.raises(AssertionError, match="pooled again"):
        summarise_campaign(outcomes[1:], out, seed=1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "schema is None"),
        ("not = [toml", "not valid TOML"),
        (HEAD, "it needs [[set]] tables"),
        (HEAD + "[[set]]\nname = 3\n", "name = 3"),
        (HEAD + '[[set]]\nname = "a"\n', "it needs [[set.device]] tables"),
        (HEAD + '[[set]]\nname = "a"\n[[set.device]]\nname = "d"\n', "lacks recordings = "),
        (HEAD + 'speed = 3\n[[set]]\nname = "a"\n', "key 'speed'"),
        (HEAD.replace("60", '"many"') + '[[set]]\nname = "a"\n', "needs a whole number"),
        (HEAD + '[[set]]\nname = "a"\n' + '[[set.device]]\nname = "d"\nrecordings = ["x.csv"]\n' * 2, "stands twice"),
    ],
)
def test_manifest_mistakes_are_named(tmp_path, text, words):
    path = tmp_path / "m.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        read_manifest(path)
    assert words in str(error.value)


SET = '[[set]]\nname = "a"\n[[set.device]]\nname = "d"\nrecordings = ["x.csv"]\n'


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("seed = -1", "option seed = -1; allowed is 0 to 4294967295"),
        (f"seed = {'9' * 400}", "option seed = 99999999999999999999...; allowed is 0 to 4294967295"),
        (f"seed = 0x{'f' * 5000}", "option seed = a number of thousands of digits; allowed"),
        ("max_steps = 0", "option max_steps = 0; allowed is 1 to 1000000"),
        ("rate_Hz = nan", "rate nan Hz: allowed is 1e-6 to 1e7 Hz"),
        (f"rate_Hz = {'9' * 400}", "Hz: allowed is 1e-6 to 1e7 Hz"),
        ('priors = "/etc/passwd"', "do not ship with shj-bayes; choose one of afc, general, or name a .toml file"),
        ('priors = "none.toml"', "cannot read none.toml"),
        ('columns = "forse=3"', "--columns: 'forse' is no channel of the law; did you mean 'force'"),
        ('units = "mm,mm"', "--units"),
        ('free = ["Fy"]', "'Fy' cannot be freed"),
        ('noise = "none"', "noise 'none' is not known"),
    ],
)
def test_options_of_a_manifest_are_checked_with_their_line(tmp_path, option, words):
    path = tmp_path / "m.toml"
    path.write_text(HEAD + SET + "[set.device.options]\n" + option, encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        read_manifest(path)
    assert str(error.value).startswith("m.toml, line 11: set 'a', device 'd' ")
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('simulated = "yes"\n', "m.toml, line 2: the manifest has simulated = 'yes'; it needs true or false"),
        ("simulated = 1\n", "line 2: the manifest has simulated = 1"),
        ("name = 3\n", "line 2: the manifest has name = 3; it needs a text"),
        ('name = """\nsimulated = 1\n"""\nsimulated = 1\n', "line 5: the manifest has simulated = 1"),
    ],
)
def test_the_head_of_a_manifest_is_checked_with_its_line(tmp_path, text, words):
    path = tmp_path / "m.toml"
    path.write_text('schema = "shj-bayes/campaign/1"\n' + text + SET, encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        read_manifest(path)
    assert words in str(error.value)


def test_a_rate_may_stand_before_the_columns_that_allow_it(tmp_path):
    path = tmp_path / "m.toml"
    own = '[set.device.options]\nrate_Hz = 100.0\ncolumns = "force=3"\n'
    path.write_text(HEAD + 'columns = "time=1"\n' + SET + own, encoding="utf-8")
    assert read_manifest(path).devices[0].options.columns == "force=3"


def test_the_fuzzers_manifest_is_a_good_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "fuzz"))
    path = tmp_path / "m.toml"
    path.write_text(importlib.import_module("originals").MANIFEST, encoding="utf-8")
    assert len(read_manifest(path).devices) == 3


def test_the_line_is_found_at_once_behind_a_long_text(tmp_path):
    path = tmp_path / "m.toml"
    many = 'schema = "shj-bayes/campaign/1"\nname = """' + "x\n" * 40_000 + '"""\nsimulated = 1\n'
    path.write_text(many + SET, encoding="utf-8")
    begin = time.process_time()
    with pytest.raises(CampaignError, match=r"m\.toml, line 40003: the manifest has simulated = 1"):
        read_manifest(path)
    assert time.process_time() - begin < 5


def test_priors_that_lack_a_law_are_refused_before_any_device_is_fitted(tmp_path):
    own = shipped("priors", "afc.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(own.replace("[gamma]", "[skip]").split("[skip]")[0], encoding="utf-8")
    path = tmp_path / "m.toml"
    path.write_text(HEAD + 'priors = "own.toml"\n' + SET, encoding="utf-8")
    with pytest.raises(CampaignError, match=r"m\.toml, line 10: set 'a', device 'd' .* hold no law for gamma"):
        read_manifest(path)


def test_failed_devices_have_a_status_of_their_own_even_when_quiet(campaign):
    _, out, _ = campaign
    path = out.parent / "campaign.toml"
    for option in ("--quiet", "--json"):
        done = CliRunner().invoke(main, ["campaign", str(path), "-o", str(out), "--diagnose", "off", option])
        assert done.exit_code == 3
        assert "1 of 4 devices failed: coated <b>, ../../broken" in done.stderr
        assert (option == "--json") == bool(done.stdout)


def test_what_recordings_say_of_themselves_reaches_campaign_and_sheet(tmp_path, no_workers):
    """A recording in two sets is said; so is that it was simulated, whatever the manifest says."""
    (made,) = simulate_device(Truth(phi=0.3), seed=1, rate_Hz=4.0, blocks=BLOCKS, n_runs=1)
    write_csv(tmp_path / "a.csv", made, comment="SIMULATED")
    (tmp_path / "b.csv").write_bytes((tmp_path / "a.csv").read_bytes())
    text = HEAD
    for set_name, file in (("bare", "a.csv"), ("coated", "b.csv")):
        text += f'[[set]]\nname = "{set_name}"\n[[set.device]]\nname = "d"\nrecordings = ["{file}"]\n'
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    manifest = read_manifest(tmp_path / "m.toml")
    assert manifest.simulated is False
    out = tmp_path / "out"
    result = summarise_campaign(run_campaign(manifest, out, workers=1, diagnose="off"), out, seed=1)
    said = "The same recording is in 2 devices, which counts one test as several: bare, d (a.csv), coated, d (b.csv)."
    assert said in result.text
    for page in ("report.html", "margins.html"):
        assert "Simulated data." in (out / page).read_text(encoding="utf-8")
    assert said in (out / "report.html").read_text(encoding="utf-8")


def test_runs_stand_with_a_device_or_among_the_options(tmp_path):
    path = tmp_path / "m.toml"
    device = '[[set.device]]\nname = "{}"\nrecordings = ["x.csv"]\n'
    text = HEAD + 'runs = "one"\n[[set]]\nname = "a"\n' + device.format("d") + "runs = 3\n" + device.format("e")
    path.write_text(text, encoding="utf-8")
    assert [d.options.runs for d in read_manifest(path).devices] == [3, "one"]
    for wrong in ("0", '"two"', "true", "1.5"):
        path.write_text(text.replace("runs = 3", f"runs = {wrong}"), encoding="utf-8")
        with pytest.raises(CampaignError, match=r"m\.toml, line \d+: set 'a', device 'd'.*runs"):
            read_manifest(path)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ('units = "s,in,kip"', "put it into a table [defaults], [set.options] or [set.device.options]"),
        ('coating = "zinc"', "put it directly below [[set]]"),
        ("recording = 3", "did you mean 'recordings'?"),
    ],
)
def test_a_key_below_a_device_is_refused_with_the_table_where_it_belongs(tmp_path, key, words):
    path = tmp_path / "m.toml"
    device = f'[[set.device]]\nname = "d"\nrecordings = ["x.csv"]\n{key}\n'
    path.write_text(HEAD + f'[[set]]\nname = "a"\n{device}', encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        read_manifest(path)
    assert f"set 'a', device 'd' has the key '{key.split()[0]}'" in str(error.value)
    assert words in str(error.value)
    path.write_text(HEAD + '[[set]]\nname = "a"\ndevice = ["d"]\n', encoding="utf-8")
    with pytest.raises(CampaignError, match="'a'"):
        read_manifest(path)


ODD = ["zinc 70|A", "zinc|70 A", "CON|NUL", "con|nul.", "a|b.", "a|b...", "a|" + "x" * 79 + "y", "\u00e5|A", "\u212b|B"]


def test_names_that_look_alike_are_other_devices_unless_they_are_the_same(tmp_path):
    path = tmp_path / "campaign.toml"

    def manifest(pairs):
        parts = (f"[[set]]\nname = {json.dumps(s)}\n[[set.device]]\nname = {json.dumps(d)}\n" for s, d in pairs)
        path.write_text(HEAD + "".join(f'{part}recordings = ["x.csv"]\n' for part in parts), encoding="utf-8")
        return read_manifest(path).devices

    pairs = [one.split("|") for one in ODD]
    pairs += [("letters", chr(0x4E00 + i)) for i in range(6000)]
    assert len({device.folder for device in manifest(pairs)}) == len(pairs)
    for same in ("e\u0301", "\u00e9 ", "\u00e9\u200b"):
        with pytest.raises(CampaignError, match="stands twice in set 'a'"):
            manifest([("a", "\u00e9"), ("a", same)])
    with pytest.raises(CampaignError, match="stands twice"):  # 80 letters are kept
        manifest([("a", "x" * 5000), ("a", "x" * 4999)])


def test_folder_names_stay_inside_and_differ():
    names = ["../../x", "..", "CON", "a/b", "a\\b", "ü" * 300, "x\x00y", "a b", "a-b"]
    folders = [*map(folder_name, names), folder_name("zinc 70", "A"), folder_name("zinc", "70 A")]
    assert len(set(folders)) == len(names) + 2
    for folder in folders:
        assert folder
        assert not set(folder) & set('/\\:*?"<>|\x00')
        assert not folder.startswith(".")
        assert len(folder) < 80


@pytest.mark.parametrize(
    ("text", "modes"),
    [
        ("", ["quick", "quick", "quick"]),
        ('diagnose = "off"\n', ["off", "off", "off"]),
        ('diagnose = "full"\n[defaults]\nseed = 2\n', ["full", "full", "full"]),
    ],
)
def test_how_to_diagnose_stands_in_the_manifest_for_all_for_a_set_or_for_a_device(tmp_path, text, modes):
    device = '[[set.device]]\nname = "{}"\nrecordings = ["x.csv"]\n'
    rest = '[[set]]\nname = "a"\n' + device.format("d") + device.format("e") + '[[set]]\nname = "b"\n{}'
    rest += device.format("f")
    path = tmp_path / "m.toml"
    start = 'schema = "shj-bayes/campaign/1"\n' + text
    path.write_text(start + rest.format(""), encoding="utf-8")
    assert [d.diagnose for d in read_manifest(path).devices] == modes
    own = rest.format('diagnose = "full"\n').replace('name = "e"\n', 'name = "e"\ndiagnose = "off"\n')
    path.write_text(start + own, encoding="utf-8")
    assert [d.diagnose for d in read_manifest(path).devices] == [modes[0], "off", "full"]


@pytest.mark.parametrize(
    ("before", "below", "words"),
    [
        ('diagnose = "quik"\n', "", "m.toml, line 2: the manifest has diagnose = 'quik'"),
        ('diagnose = "quik"\n', "", 'it needs "quick" or "full" or "off"; did you mean \'quick\'?'),
        ("diagnose = false\n", "", "m.toml, line 2: the manifest has diagnose = False"),
        ("", "diagnose = 1\n", "m.toml, line 7: set 'a', device 'd' has diagnose = 1"),
        ('diagnos = "off"\n', "", "did you mean 'diagnose'?"),
        ('[defaults]\ndiagnose = "off"\n', "", "line 3: the manifest has the key 'diagnose', which has no effect"),
        ("", '[set.device.options]\ndiagnose = "off"\n', "put it at the top of the manifest, below [[set]] or below"),
    ],
)  # fmt: skip
def test_a_wrong_way_to_diagnose_is_refused_with_its_line(tmp_path, before, below, words):
    path = tmp_path / "m.toml"
    path.write_text('schema = "shj-bayes/campaign/1"\n' + before + SET + below, encoding="utf-8")
    with pytest.raises(CampaignError) as error:
        read_manifest(path)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ('bolts = "two"', "line 8: set 'a', its connection has bolts = 'two'; it needs a whole number"),
        ("bolts = 0", "numbers of a connection must lie between 0 and 10000"),
        ("slot_mm = 14\nbolt_mm = 16", "a slot of 14 mm is no longer than its bolt of 16 mm"),
        ('displacement = "frame"', 'displacement is measured at the "device" or at the "machine"'),
        ("bolt = 16", "known are bolts, bolt_mm"),
    ],
)
def test_a_connection_that_cannot_be_is_refused(tmp_path, said, words):
    path = tmp_path / "m.toml"
    device = '[[set.device]]\nname = "d"\nrecordings = ["d.csv"]\n'
    path.write_text(f'{HEAD}[[set]]\nname = "a"\n[set.connection]\n{said}\n{device}', encoding="utf-8")
    with pytest.raises(CampaignError, match=re.escape(words)):
        read_manifest(path)


def test_a_wrong_way_to_diagnose_is_refused_where_a_campaign_is_run(tmp_path):
    path = tmp_path / "m.toml"
    path.write_text(HEAD + SET, encoding="utf-8")
    with pytest.raises(CampaignError, match=r"diagnose = 'ful'; allowed are quick, full, off; did you mean 'full'\?"):
        run_campaign(read_manifest(path), tmp_path / "out", diagnose="ful")
    done = CliRunner().invoke(main, ["campaign", str(path), "-o", str(tmp_path / "out"), "--diagnose", "ful"])
    assert done.exit_code == 2
