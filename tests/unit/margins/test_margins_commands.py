"""The commands on a written population: margins, export, compare."""

import json
import math
import re
import runpy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from shj_bayes.app.design import margin_text
from shj_bayes.cli import main
from shj_bayes.errors import PopulationError
from shj_bayes.margins.sheet import margins
from shj_bayes.margins.spread import HIGH, LOW
from shj_bayes.options import MarginOptions
from shj_bayes.population.compare import is_bare
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.results import write_population
from shj_bayes.report.margins_page import counted, set_table, told

LABEL = "=cmd|'<b>"
pytestmark = pytest.mark.usefixtures("brief_workbooks")  # whole ones: test_margins_uses.py


@pytest.fixture(scope="module")
def folder(population, tmp_path_factory):
    place = tmp_path_factory.mktemp("tables")
    write_population(population, place)
    return place


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_margins_prints_a_table_and_writes_the_sheet(folder):
    done = run("margins", folder, "--set", "Zinc 70", "--amplitude", 48, "--cycles", 2)
    assert done.exit_code == 0, done.output
    assert "Zinc 70: 2 devices" in done.output
    assert done.output.startswith(
        "Zinc 70\n  ONE connection: 2 bolts M16 8.8, 2 sliding surfaces, slot 220 mm, free travel 102 mm to either side"
    )
    page = (folder / "margins.html").read_text(encoding="utf-8")
    assert "<strong>2 cycles of 48\N{NO-BREAK SPACE}mm at a peak speed of 10" in page
    assert "for drift and displacement" in done.output
    assert "by 11 for dep = +30" in page
    assert "by -9 for dep = -30" in page
    assert "In 500 simulated campaigns" in page
    for name in ("margins.csv", "margins.xlsx", "margins.json", "loops.csv"):
        assert (folder / name).stat().st_size > 1000


def test_the_sheet_of_published_tables_has_no_empty_columns(folder):
    """Tables know nothing of a model, so nothing is said of how well one follows."""
    done = run("margins", folder)
    assert done.exit_code == 0, done.output
    page = (folder / "margins.html").read_text(encoding="utf-8")
    assert "within a device" in page
    assert "measured / predicted" not in page
    assert "&lt;b&gt;" in page
    assert "cmd|&#39;<b>" not in page
    widths = page.partition("standard deviation, %")[2].partition("</table>")[0]
    assert '<td class="n">-</td>' not in widths


def test_wide_limits_are_printed_without_exponents_and_sets_are_counted_as_sets(design, trials):
    asked = MarginOptions(sets=("Zinc 70",))
    sheet = margins(design, trials, asked)
    wide = [replace(r, value=1e3 + r.value) if r.method == "EN 1990" and r.side == HIGH else r for r in sheet.rows]
    assert not re.search(r"\de[+-]\d", margin_text(replace(sheet, rows=tuple(wide))))
    assert counted(sheet, ANY_SET, None) == f"{len(design.sets)} sets"


def test_speeds_that_were_not_tested_are_refused(folder):
    done = run("margins", folder, "--speed", 300)
    assert done.exit_code == 1
    assert "was not tested" in done.output
    assert "--extrapolate" in done.output


def test_a_refusal_and_an_extrapolated_sheet_say_which_tests_would_lift_them(folder):
    """50 mm at 200 mm/s, tested at 10.1: the middle of both is sqrt(10.1 x 200) = 44.9, 45 mm/s with two digits."""
    test = "of each set 2 devices, 3 cycles of 50 mm at 45 and 200 mm/s"
    done = run("margins", folder, "--amplitude", 50, "--speed", 200)
    assert done.exit_code == 1
    assert test in done.output
    done = run("margins", folder, "--amplitude", 50, "--speed", 200, "--extrapolate")
    assert test in done.output
    assert test in (folder / "margins.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    done = run("margins", folder, "--amplitude", 110)
    assert "3 cycles of 110 mm at 11 mm/s" in done.output
    assert "the slot of Zinc 70, Zinc 70 corroded" in done.output
    assert "is too short for it" in done.output


def test_export_knows_sap2000_and_etabs(folder, tmp_path):
    done = run("export", folder, "--to", "etabs", "-o", tmp_path, "--json")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["connection_links.py", "link-elements.csv", "loops.csv"]
    script = runpy.run_path(str(tmp_path / "connection_links.py"))
    links = {name: values for name, values in script["LINKS"].items() if name.startswith("1 Zinc 70,")}
    assert {name.rpartition(", ")[2] for name in links} == {
        *("lower", "middle", "upper", "fresh lower", "fresh upper", "worn lower", "worn upper")
    }
    force = {name.rpartition(", ")[2]: values[1] for name, values in links.items()}
    assert force["lower"] <= force["worn lower"] < force["fresh lower"] < force["middle"] < force["upper"]
    assert {values[4] for values in links.values()} == {102.0}
    assert "ONE connection as tested" in (tmp_path / "connection_links.py").read_text(encoding="utf-8")
    assert "may have grips and frame of the testing machine in it" in (tmp_path / "link-elements.csv").read_text(
        encoding="utf-8"
    )
    assert run("export", folder, "--to", "etabs", "-o", tmp_path, "--draws", 5).exit_code == 1


def test_what_bolts_are_asked_of_goes_by_what_is_known_of_each_set(folder):
    """The paper says two bolts; of a set never tested nobody knows them."""
    done = run("margins", folder, "--force-wanted", 100, "--clamping-cov", 0.1, "--connections", 4)
    assert done.exit_code == 0, done.output
    found, _ = numbers(folder)
    assert found["Zinc 70", "bolts for the force wanted"]["value"] == math.ceil(
        200 / found["Zinc 70", "for drift and displacement"]["value"]
    )
    assert (ANY_SET, "bolts for the force wanted") not in found
    assert (ANY_SET, "sum of connections that act together") in found
    assert "4 connections together" in done.output


def test_an_unknown_set_is_named_with_those_there_are(folder):
    done = run("margins", folder, "--set", "Zink", "--speed", 8)
    assert done.exit_code == 1
    assert "'Zinc 70 corroded'" in done.output


@pytest.mark.parametrize("refused", [("--set", "Zink"), ("--speed", 300), ("--nominal", -1)])
@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_a_refused_command_leaves_the_sheet_as_it_was(folder, refused, quiet):
    assert run("margins", folder, "--quiet").exit_code == 0
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    assert run("margins", folder, "--nominal", 70, *refused, *quiet).exit_code == 1
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def test_tests_and_pools_are_kept_until_devices_or_history_change(folder, monkeypatch):
    """Another nominal force acts on what is kept, to the same numbers; what is damaged is made again."""

    def never(*_, **__):
        raise AssertionError

    def drawn(*options):
        assert run("margins", folder, "--quiet", *options).exit_code == 0
        return (folder / "margins.csv").read_bytes()

    fresh = drawn("--nominal", 70)
    with monkeypatch.context() as kept:
        kept.setattr("shj_bayes.app.design.virtual_tests", never)
        assert drawn("--nominal", 80) != fresh
        assert drawn("--nominal", 70) == fresh
        assert isinstance(run("margins", folder, "--amplitude", 48).exception, AssertionError)
    whole = (folder / "pool.npz").read_bytes()
    for damaged in (whole[:-200], whole.replace(b"rests_on", b"rests_no"), b""):
        (folder / "pool.npz").write_bytes(damaged)
        (folder / "made.json").unlink()
        assert drawn("--nominal", 70) == fresh
        assert (folder / "pool.npz").read_bytes() == whole


def test_a_nominal_force_acts_on_the_set_that_is_named_whatever_its_case(folder):
    done = run("margins", folder, "--set", "zinc 70", "--nominal", 70)
    assert done.exit_code == 0, done.output
    record = json.loads((folder / "margins.json").read_text(encoding="utf-8"))
    nominal = {m["set"]: m["value"] for m in record["margins"] if m["kind"] == "nominal sliding force"}
    assert nominal == {"Zinc 70": 70}
    refused = run("margins", folder, "--set", "Zinc 70 corodded")
    assert "did you mean 'Zinc 70 corroded'?" in refused.output


def test_a_sheet_of_one_set_speaks_of_that_set_alone_in_the_numbers_of_the_sheet_of_all(folder):
    assert run("margins", folder, "--quiet").exit_code == 0
    everything = pd.read_csv(folder / "margins.csv")
    others = set(everything["set"]) - {"Zinc 70 corroded"}
    done = run("margins", folder, "--set", "zinc 70 corroded")
    assert done.exit_code == 0, done.output
    own = pd.read_csv(folder / "margins.csv")
    whole = everything[everything["set"] == "Zinc 70 corroded"].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, whole, check_dtype=False)
    for name in ("margins-devices.csv", "loops.csv"):
        assert set(pd.read_csv(folder / name)["set"]) == {"Zinc 70 corroded"}
    told = [done.output, *((folder / name).read_text(encoding="utf-8") for name in ("margins.html", "margins.json"))]
    for text in told:
        left = text.replace("Zinc 70 corroded", "")
        assert not [name for name in others if name in left]
        assert "a set never tested" not in left
        assert "learnt from all sets that were tested (3)" in left


def test_what_to_mind_is_counted_over_the_sets_that_are_asked_for(design, trials):
    two = margins(design, trials, MarginOptions(sets=("Zinc 70", "Zinc 70 corroded")))
    assert two.spoken == ("Zinc 70", "Zinc 70 corroded")
    assert {trial.set_name for trial in two.tests} == set(two.spoken)
    assert any("2 of 2 sets rest on one or two" in line for line in two.warnings)


def test_export_writes_scripts_and_a_table(folder, tmp_path):
    done = run("export", folder, "--to", "opensees", "-o", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output
    record = json.loads(done.output)
    assert record["schema"] == "shj-bayes/export/1"
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["connection_materials.py", "connection_materials.tcl", "link-elements.csv", "loops.csv"]
    table = (tmp_path / "out" / "link-elements.csv").read_text(encoding="utf-8")
    assert "'=cmd" in table
    compile((tmp_path / "out" / "connection_materials.py").read_text(encoding="utf-8"), "script", "exec")
    assert run("export", folder, "--to", "elsewhere").exit_code == 2


def test_export_draws_new_devices_for_monte_carlo(folder, tmp_path):
    done = run("export", folder, "--to", "opensees", "-o", tmp_path, "--draws", 20, "--json")
    assert done.exit_code == 0, done.output
    assert "connection_draws.py" in done.output
    table = pd.read_csv(tmp_path / "connection_draws.csv")
    assert table.groupby("set").size().to_dict() == {"Zinc 70": 20, "Zinc 70 corroded": 20, "'" + LABEL: 20}
    zinc = table[table["set"] == "Zinc 70"]
    # 92.5 kN at rest; at 9.57 mm/s dep of -60 to -90 mm/s takes 11 to 16 % off.
    assert 75 < zinc["force_kN"].median() < 87
    assert zinc["force_2_kN"].median() < zinc["force_kN"].median()
    assert zinc["force_kN"].nunique() == 20
    script = runpy.run_path(str(tmp_path / "connection_draws.py"))
    first = zinc.iloc[0]
    assert script["DEVICES"]["Zinc 70", 1][:3] == pytest.approx(
        (first.force_kN, first.force_2_kN, first.K_kN_mm), rel=1e-4
    )
    # dep of -60 and -90 mm/s: the force falls with speed, so it is larger at rest; corroded it grows.
    assert zinc["share_at_rest"].median() > 1 > table[table["set"] == "Zinc 70 corroded"]["share_at_rest"].median()
    refused = run("export", folder, "--to", "opensees", "-o", tmp_path, "--draws", 0)
    assert refused.exit_code == 1
    assert "allowed are 1 to" in refused.output


def test_compare_prints_a_table_and_counts_its_tests(folder):
    done = run("compare", folder, "corroded", "uncorroded", "--rope", 15)
    assert done.exit_code == 0, done.output
    assert "P(same)" in done.output
    assert "4 forces and 5 parameters were compared" in done.output
    record = json.loads(run("compare", folder, "corroded", "uncorroded", "--json").output)
    assert record["contrasts"][0]["permutation_p"] is not None
    assert record["strata"] == 1
    assert [c["quantity"] for c in record["contrasts"]][:5] == ["plateau", "highest", "plateau_2", "energy", "K"]
    force = next(c for c in record["contrasts"] if c["quantity"] == "Fy")
    assert force["observed"] == pytest.approx((70 * 75 / (90 * 95)) ** 0.5)
    assert force["pairs"][0]["devices_b"] == pytest.approx({"1": 90.0, "2": 95.0})
    stored = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    assert stored == record
    devices = pd.read_csv(folder / "comparison-devices.csv")
    assert len(devices) == 9 * 4
    assert len(pd.read_excel(folder / "comparison.xlsx", sheet_name="Devices")) == len(devices)
    assert len(pd.read_csv(folder / "comparison.csv")) == 9
    assert run("compare", folder, "corroded", LABEL).exit_code == 1


def test_both_sides_of_a_comparison_are_listed_in_a_table_whose_columns_stand_apart(folder):
    lines = run("compare", folder, "corroded", "uncorroded").output.splitlines()
    assert lines[:2] == ["a: corroded (Zinc 70 corroded)", "b: uncorroded (Zinc 70)"]
    head, *rows = [re.split(r" {2,}", line.strip()) for line in lines[2 : lines.index("")]]
    assert len(rows) == 9
    for row in rows:
        assert len(row) == len(head) + 1
        assert re.fullmatch(r"[-.e\d]+ to [-.e\d]+", row[3])
    record = json.loads(run("compare", folder, "corroded", "uncorroded", "--json").output)
    assert record["members"] == {"a": ["Zinc 70 corroded"], "b": ["Zinc 70"]}


def test_a_blasted_surface_is_a_coating_as_in_the_paper():
    assert [is_bare(words) for words in ("none", "Mill-Scale", "Uncoated", "bare", "")] == [True] * 5
    assert [is_bare(words) for words in ("zinc", "sweep blasted", "Sweep-Blasted", "blasted")] == [False] * 4


def test_a_folder_without_a_population_says_what_to_run(tmp_path):
    for command in (("margins", tmp_path), ("export", tmp_path, "--to", "opensees")):
        done = run(*command)
        assert done.exit_code == 1
        assert "shj-bayes tables" in done.output


def test_a_missing_factor_is_told_by_its_value_not_by_a_dash(design, trials):
    sheet = replace(margins(design, trials, MarginOptions(sets=("Zinc 70",))), spoken=("Zinc  -  70 -",))
    rows = [replace(row, set_name="Zinc  -  70 -") for row in sheet.rows]
    known = [replace(row, value=50.0) if row.method == "EN 1990" else row for row in rows]
    assert "has no factor" not in margin_text(replace(sheet, rows=tuple(known)))
    lacks = [
        replace(row, value=math.nan) if row.method == "EN 1990" and row.quantity == "third" else row for row in known
    ]
    assert margin_text(replace(sheet, rows=tuple(lacks))).count("has no factor") == 1


def test_bounds_are_shown_for_the_class_that_was_asked_for(design, trials):
    third = MarginOptions(importance="III", sets=("Zinc 70",))
    sheet = margins(design, trials, third)
    bound = sheet.by_key["Zinc 70", "force", "EN 15129 LBDP, importance class III", LOW]
    assert re.search(rf"EN 15129: LBDP, UBDP +{told(bound)} ", margin_text(sheet))
    factors = next(row["factors"] for row in set_table(sheet, "III") if row["name"] == "Zinc 70")
    assert factors[11] == bound


def test_a_history_of_ones_own_is_driven_through(folder, tmp_path):
    path = tmp_path / "drift.csv"
    time = np.linspace(0.0, 120.0, 400)
    drift = 60.0 * np.sin(2 * np.pi * 0.025 * time) * np.minimum(1.0, time / 60.0)
    path.write_text("time,drift\n" + "\n".join(f"{t},{x}" for t, x in zip(time, drift, strict=True)), encoding="utf-8")
    done = run("margins", folder, "--history", path)
    assert done.exit_code == 0, done.output
    record = json.loads((folder / "margins.json").read_text(encoding="utf-8"))
    assert record["history"] == "the slip of drift.csv (slip up to 60 mm at up to 9.43 mm/s)"
    assert run("margins", folder, "--history", path, "--cycles", 3).exit_code == 1
    path.write_text(path.read_text(encoding="utf-8") + "x,y\n" * 3, encoding="utf-8")
    done = run("margins", folder, "--history", path)
    assert "drift.csv: 3 lines below the numbers left out" in done.output
    path.write_text("nothing\n", encoding="utf-8")
    assert "two or more numbers" in run("margins", folder, "--history", path).output


def numbers(folder):
    record = json.loads((folder / "margins.json").read_text(encoding="utf-8"))
    return {(m["set"], m["kind"]): m for m in record["margins"] if m["quantity"] == "force"}, record


def drift_file(path, largest_mm, period_s, rows=600):
    """Drift of a storey in metres, as a program writes it in much of Europe: semicolons and decimal commas."""
    time = np.linspace(0.0, 120.0, rows)
    drift = largest_mm / 1000.0 * np.sin(2 * np.pi * time / period_s)
    lines = (f"{t:.4f};{x:.7f}".replace(".", ",") for t, x in zip(time, drift, strict=True))
    path.write_text("\n".join(["time [s];drift [m]", *lines]) + "\n", encoding="utf-8")
    return path


def test_the_drift_of_a_storey_is_made_the_slip_of_the_device(folder, tmp_path):
    """300 mm in a storey of 3.6 m with an arm of 600 mm are 50 mm; at 40 s a peak speed of 2 pi 50 / 40 = 7.85 mm/s."""
    drift = drift_file(tmp_path / "storey.csv", 300.0, 40.0)
    done = run("margins", folder, "--drift", drift, "--storey-height", 3600, "--lever-arm", 0.6)
    assert done.exit_code == 0, done.output
    said = "slip = drift x lever arm / storey height = 600 / 3600 mm = 0.1667 x drift; slip up to 50 mm at up to 7.8"
    found, record = numbers(folder)
    told_at = (done.output, record["history"], found["Zinc 70", "for drift and displacement"]["inputs"])
    for text in (*told_at, (folder / "margins.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")):
        assert said in text
    devices = pd.read_csv(folder / "margins-devices.csv")
    slip = drift_file(tmp_path / "slip.csv", 50.0, 40.0)
    assert run("margins", folder, "--slip", slip).exit_code == 0
    assert devices["q50"].to_numpy() == pytest.approx(pd.read_csv(folder / "margins-devices.csv")["q50"], rel=1e-3)
    brace = MarginOptions(drift=drift, brace_angle_deg=60.0)
    assert brace.slip_of_drift == (pytest.approx(0.5), "slip = drift x cos 60 deg = 0.5 x drift")


def test_a_drift_that_the_devices_do_not_allow_is_refused_with_what_they_do(folder, tmp_path):
    """60 mm of drift are 10 mm of slip: too little to slide fully; read as slip they were 60 mm at 293 mm/s."""
    arm = ("--storey-height", 3.6, "--lever-arm", 0.6)
    done = run("margins", folder, "--drift", drift_file(tmp_path / "small.csv", 60.0, 40.0), *arm)
    assert done.exit_code == 1
    assert "an amplitude of 10 mm; these devices allow a slip of " in done.output
    slip, drift = re.search(
        r"a slip of ([\d.]+) to 95 mm .*a drift of (\d+) to 570 mm at up to 6", done.output
    ).groups()
    assert 12 < float(slip) < 40
    assert float(drift) == pytest.approx(6 * float(slip), rel=0.01)
    done = run("margins", folder, "--drift", drift_file(tmp_path / "large.csv", 600.0, 60.0), *arm)
    assert "reaches a position of 100 mm" in done.output
    assert f"These devices allow a slip of {slip} to 95 mm" in done.output
    done = run("margins", folder, "--slip", drift_file(tmp_path / "fast.csv", 60.0, 2 * math.pi * 60 / 293, 6000))
    assert "reaches a speed of 29" in done.output
    assert f"these devices allow a slip of {slip} to 95 mm at up to 10" in done.output


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"drift": "d.csv"}, "not drift"),
        ({"storey_height": 3.6, "lever_arm": 0.6}, "not drift"),
        ({"drift": "d.csv", "storey_height": 3.6}, "not drift"),
        ({"drift": "d.csv", "storey_height": 3.6, "lever_arm": 0.6, "brace_angle_deg": 30}, "not drift"),
        ({"drift": "d.csv", "storey_height": 36, "lever_arm": 600}, "storey_height = 36; allowed is 1000 to 19999 mm"),
        ({"drift": "d.csv", "brace_angle_deg": 90}, "below 90"),
        ({"slip": "s.csv", "history": "h.csv"}, "give one history"),
        ({"slip": "s.csv", "cycles": 3}, "give one history"),
        ({"bolts": 2, "mu": 0.2}, "--bolts, --mu and --clamping"),
        ({"lever_arm": 0.6, "brace_angle_deg": 30}, "not drift"),
        ({"connections": 0}, "allowed is 1 to 1000"),
        ({"reliability": "0.9999"}, "a share of 0.5 to 0.999"),
        ({"reliability": "beta=x"}, "a share of 0.5 to 0.999"),
        ({"clamping_cov": 1.2}, "between 0 and 1"),
        ({"force_wanted_kN": -1}, "above zero"),
        ({"bolts": 2, "mu": 0.2, "clamping_kN": 95, "nominal_kN": 80}, "no --nominal beside them"),
        ({"bolts": 2, "mu": 21, "clamping_kN": 95}, "mu = 21; allowed is between 0 and 2"),
        ({"bolts": 0, "mu": 0.2, "clamping_kN": 95}, "above zero"),
    ],
)
def test_halves_of_a_conversion_or_a_nominal_force_are_refused(asked, words):
    with pytest.raises(PopulationError, match=re.escape(words)):
        MarginOptions(**asked)


def test_the_two_numbers_hold_at_a_lower_speed_than_the_tested_one(folder):
    """Corroded, the force grows with speed: 10 mm/s for dep = 60 and 90 mm/s make a seventh of it and a tenth."""
    done = run("margins", folder)
    assert (
        "at every speed from standstill to 10.2 mm/s, in the test that each device went through (ageing" in done.output
    )
    tested, _ = numbers(folder)
    assert run("margins", folder, "--amplitude", 95, "--speed", 1).exit_code == 0
    slow, _ = numbers(folder)
    for name in ("Zinc 70", "Zinc 70 corroded"):
        for kind in ("for drift and displacement", "for capacity design"):
            assert tested[name, kind]["value"] == pytest.approx(slow[name, kind]["value"], rel=0.07)
    nominal = [found["Zinc 70 corroded", "nominal sliding force"]["value"] for found in (tested, slow)]
    assert nominal[1] < 0.93 * nominal[0]  # of the history itself, with its speed in words
    assert "third cycle of a typical device at 1 mm/s" in slow["Zinc 70", "nominal sliding force"]["formula"]
    record = json.loads((folder / "margins.json").read_text(encoding="utf-8"))
    service = {m["quantity"] for m in record["margins"] if "slip at service loads" in m["purpose"]}
    assert service == {"force", "lowest", "least", "least_2"}  # not a plateau at the speed of one history


def test_numbers_that_no_test_stands_behind_say_so_wherever_they_stand(folder):
    done = run("margins", folder, "--speed", 300, "--extrapolate")
    assert done.exit_code == 0, done.output
    box = "No device was tested in this. The two numbers are the outermost of laws"
    end = done.output[done.output.index("EXTRAPOLATED. " + box) :]
    assert "Code values are withheld: the laws of what was not tested part by a factor of" in end
    assert end.count("kN (extrapolated, not tested)") == 3
    assert "phi_o" not in done.output
    page = (folder / "margins.html").read_text(encoding="utf-8")
    assert page.index(box) < page.index("all events")
    assert "use these two" not in page + done.output
    assert "95 % of new devices stay above it" not in page
    assert "Nothing here holds outside" not in page
    found, record = numbers(folder)
    codes = [m for m in record["margins"] if m["method"] in ("EN 1990", "tolerance", "factor")]
    assert {m["value"] for m in codes} == {None}
    assert all("withheld: the laws" in m["note"] for m in codes)
    assert "slip at service loads" not in found["Zinc 70", "for drift and displacement"]["purpose"]
    loops = pd.read_csv(folder / "loops.csv")
    assert set(loops["law"]) == {"held", "saturating", "logarithmic"}
    middle = loops[(loops["set"] == "Zinc 70") & (loops["run"] == 2) & (loops["displacement_mm"].abs() < 20)]
    least = middle.groupby("law")["push_q50_kN"].max()
    assert least["logarithmic"] < 0.7 * least["held"]


def test_every_factor_has_its_nominal_force_beside_it(folder):
    """V_ss = 2 bolts x 2 surfaces x 0.21 x 95 kN = 79.8 kN."""
    done = run("margins", folder, "--set", "Zinc 70", "--bolts", 2, "--mu", 0.21, "--clamping", 95)
    assert done.exit_code == 0, done.output
    said = "V_ss = 2 bolts x 2 surfaces x mu 0.21 x 95 kN"
    assert re.search(rf"nominal +79.8 +kN +{re.escape(said)}", done.output)
    assert said in (folder / "margins.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    found, _ = numbers(folder)
    capacity, phi_o = (found["Zinc 70", kind] for kind in ("for capacity design", "phi_o equivalent"))
    assert phi_o["value"] == pytest.approx(capacity["value"] / 79.8)
    assert said in phi_o["inputs"]
    done = run("margins", folder, "--set", "Zinc 70")
    assert re.search(r"nominal .* third cycle of a typical device at 10 mm/s, first run", done.output)
