import json
import math
from dataclasses import replace

import numpy as np
import openpyxl
import pytest

from shj_bayes.errors import PopulationError
from shj_bayes.margins.agreement import agreement
from shj_bayes.margins.codes import en1990, iso16269_6
from shj_bayes.margins.files import design_table, to_json, to_table, write_margins
from shj_bayes.margins.loops_file import loops, write_loops
from shj_bayes.margins.parts import corroded_pairs
from shj_bayes.margins.request import Request
from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sheet import margins
from shj_bayes.margins.speed_guard import LAWS, Guard, published_factors
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.population.predict import new_device
from shj_bayes.population.tested import PUBLISHED, RangeTested, common

LABEL = "=cmd|'<b>"


@pytest.fixture(scope="module")
def sheet(population):
    return margins(population)


def test_every_number_says_where_it_comes_from(sheet):
    for row in sheet.rows:
        assert row.clause
        assert row.formula
        assert row.inputs
        assert row.purpose
        assert row.unit in {"kN", "kN/mm", "kJ", "1"}
        assert math.isfinite(row.value) or row.note
    assert len({row.key for row in sheet.rows}) == len(sheet.rows)
    assert {row.quantity for row in sheet.rows} == {"Fy", "Fy_second", "ratio", "degradation", "K", "energy", "force"}
    assert {row.set_name for row in sheet.rows} == {"Zinc 70", "Zinc 70 corroded", LABEL, ANY_SET}


def test_bands_are_those_of_a_new_device(sheet, population):
    bands = {p: new_device(population, "Zinc 70", p).band("Fy") for p in ("default", *population.other_priors)}
    low, high = min(b[0] for b in bands.values()), max(b[2] for b in bands.values())
    assert low < bands["default"][0]  # two devices of its own: the outermost of the three priors
    for side, level, value in ((LOW, 5, low), (MIDDLE, 50, bands["default"][1]), (HIGH, 95, high)):
        row = sheet.get("Zinc 70", "Fy", f"new device, {level} %", side)
        assert row.value == pytest.approx(value)
        assert all(f"'{p}'" in row.inputs for p in bands)
        assert ("outermost of 3 priors" in row.note) is (side != MIDDLE)
    energy = sheet.get("Zinc 70", "energy", "new device, 50 %", MIDDLE).value
    assert energy == pytest.approx(4 * 0.095 * 92 * (1 - np.pi / 4 * 10.25 / 72) * (1 - 92 / 11.4 / 95), rel=0.05)


def test_values_by_testing_follow_from_the_devices(sheet):
    logs = np.log([90.0, 95.0])
    spread = math.sqrt((logs.var(ddof=1) + np.log([70.0, 75.0]).var(ddof=1)) / 2)
    assert spread == pytest.approx(0.0438, abs=1e-4)  # below 0.10, so s_y = sqrt(ln 1.01) = 0.09975
    row = sheet.get("Zinc 70", "Fy", "EN 1990 characteristic, lognormal, V common", LOW)
    assert row.value == pytest.approx(math.exp(logs.mean() - en1990.factor_unknown(2, degrees=2) * 0.099751), rel=1e-5)
    assert "V raised from 0.044 to 0.1" in row.note
    assert (row.n_devices, row.degrees) == (2, 2)
    assert not any("V known" in row.kind for row in sheet.rows)
    row = sheet.get("Zinc 70", "Fy", "tolerance 95/95 one-sided, normal, V unknown", HIGH)
    assert row.value == pytest.approx(
        92.5 * (1 + iso16269_6.one_sided(2, 0.95, 0.95) * np.std([90, 95], ddof=1) / 92.5)
    )
    assert "V common" in row.note
    row = sheet.get("Zinc 70", "Fy", "EN 1990 characteristic, lognormal, V unknown", LOW)
    assert math.isnan(row.value)
    assert "no factor for n = 2" in row.note


def test_one_device_has_no_spread_of_its_own(sheet):
    assert sheet.get(LABEL, "Fy", "EN 1990 characteristic, lognormal, V unknown", LOW) is None
    assert sheet.get(LABEL, "Fy", "EN 1990 characteristic, lognormal, V common", LOW).degrees == 2
    # Two degrees of freedom are those of three devices, for which Table D2 has no factor.
    design = sheet.get(LABEL, "Fy", "EN 1990 design, lognormal, V common", LOW)
    assert math.isnan(design.value)
    assert "no factor for n = 3" in design.note


def test_degradation_turns_the_ratio_round(sheet, population):
    for kind, mirrored in (
        ("new device, 5 %", "new device, 95 %"),
        ("EN 1990 characteristic, lognormal, V common",) * 2,
    ):
        ratio = sheet.get("Zinc 70", "ratio", kind, LOW).value
        row = sheet.get("Zinc 70", "degradation", mirrored, HIGH)
        assert row.value == pytest.approx(1 - ratio)
    assert row.inputs.startswith("of the ratio: m_y")
    band = sheet.get("Zinc 70", "degradation", "new device, 95 %", HIGH)
    own = {p: 1 - new_device(population, "Zinc 70", p).band("ratio")[0] for p in ("default", "alike", "free")}
    for label, value in own.items():
        assert f"{value:.4g} under the prior '{label}'" in band.inputs
    assert band.value == pytest.approx(max(own.values()))


def test_factors_multiply(sheet, population):
    def value(kind, side):
        return sheet.get("Zinc 70", "Fy", kind, side).value

    age = value("lambda_ae,min", LOW)
    assert corroded_pairs(population) == [(0, 1)]
    assert 0.7 < age < 0.9
    test, spec = value("lambda_test,min", LOW), value("lambda_spec,min", LOW)
    assert value("lambda_min", LOW) == pytest.approx((1 - 0.75 * (1 - age)) * test * spec)
    assert value("ASCE 7 lower bound force", LOW) == pytest.approx(
        value("lambda_min with the floor for dampers", LOW) * value("nominal sliding force", MIDDLE)
    )
    draws = [new_device(population, "Zinc 70", p).draws for p in ("default", *population.other_priors)]
    nominal, v = value("nominal sliding force", MIDDLE), 10.25
    low = min(np.quantile(d["Fy"] * np.clip(1 + v * d["gamma"], 0.01, 1), 0.05) for d in draws)
    assert value("phi equivalent, first run", LOW) == pytest.approx(low / nominal)
    high = max(
        np.quantile(np.maximum(d["Fy"], d["Fy_second"]) * np.maximum(1, 1 + v * d["gamma"]), 0.95) for d in draws
    )
    assert value("phi_o equivalent", HIGH) == pytest.approx(high / nominal)
    # gamma of this set is near -1/72 s/mm, so the force delivered is well below that at standstill
    assert low < min(np.quantile(d["Fy"], 0.05) for d in draws)
    own = sheet.get("Zinc 70 corroded", "Fy", "lambda_ae,min", LOW)
    assert own.value == 1.0
    assert "tested corroded" in own.inputs
    assert "nothing is known" in sheet.get(LABEL, "Fy", "lambda_ae,max", HIGH).inputs


def test_nominal_and_importance_are_the_users(population):
    by_self = margins(population)
    sheet = margins(population, Request(nominal_kN=80.0, importance="III"))
    kind = "phi equivalent, first run"
    typical = by_self.get("Zinc 70", "Fy", "nominal sliding force", MIDDLE).value
    assert sheet.get("Zinc 70", "Fy", kind, LOW).value == pytest.approx(
        by_self.get("Zinc 70", "Fy", kind, LOW).value * typical / 80.0
    )
    upper = [s.get("Zinc 70", "Fy", "ASCE 7 upper bound force", HIGH).value for s in (by_self, sheet)]
    assert upper[0] == pytest.approx(upper[1])  # a low nominal force does not lower the bound
    assert sheet.get("Zinc 70", "Fy", "EN 15129 LBDP, importance class III", LOW) is not None
    with pytest.raises(PopulationError, match="above zero"):
        Request(nominal_kN=-1.0)


def test_nothing_is_said_of_speeds_that_were_not_tested(population):
    with pytest.raises(PopulationError, match=r"300 mm/s was not tested.*by 11 for.*by -9 for.*--extrapolate"):
        margins(population, Request(speed_mm_s=300.0))
    with pytest.raises(PopulationError, match=r"120 mm was not tested; tested were 5\.94 to 95 mm"):
        margins(population, Request(amplitude_mm=120.0))
    with pytest.raises(PopulationError, match="above zero"):
        margins(population, Request(speed_mm_s=-3.0))


def test_extrapolation_is_the_spread_of_bounded_laws(population, sheet):
    beyond = margins(population, Request(speed_mm_s=300.0, extrapolate=True))
    row = beyond.get("Zinc 70", "force", "new device, 5 %", LOW)
    assert 0 < row.value < sheet.get("Zinc 70", "force", "new device, 5 %", LOW).value
    assert all(law in row.note for law in LAWS)
    assert beyond.warnings[0].startswith("300 mm/s was NOT tested")
    assert "means nothing there" in beyond.warnings[0]
    assert loops(population, beyond.motion) == ()


def test_bounded_laws_agree_with_the_tests_and_stay_above_zero():
    for shape in LAWS.values():
        assert shape(10.0, 10.0) == pytest.approx(1.0)
    guard = Guard(RangeTested(6, 95, 9.8, 10.0), 300.0, extrapolate=True)
    gammas = guard.gammas(np.array([-1 / 30, 1 / 30, -0.2]))
    for gamma in gammas.values():
        assert np.all(1 + gamma * 300.0 >= 0)
    assert 1 + gammas["held"][0] * 300.0 == pytest.approx(2 / 3)
    assert "11" in published_factors(300.0)
    assert "-9" in published_factors(300.0)
    assert "means nothing" not in published_factors(5.0)


def test_tested_range_is_what_all_devices_saw():
    a, b = RangeTested(6, 95, 9.8, 10.0), RangeTested(12, 80, 9.0, 20.0)
    both = common([a, b])
    assert (both.smallest_mm, both.largest_mm, both.fastest_mm_s) == (12, 80, 10.0)
    assert common([a, RangeTested(100, 120, 9.8, 10.0)]) is None
    assert common([]) is None
    assert PUBLISHED.one_speed
    assert not RangeTested(6, 95, 2.0, 50.0).one_speed
    with pytest.raises(PopulationError, match="no larger"):
        RangeTested(95, 6, 9.8, 10.0)


def test_files_hold_the_same_numbers_and_no_formulas(sheet, tmp_path):
    paths = write_margins(sheet, tmp_path)
    assert [p.name for p in paths] == ["margins.csv", "margins.xlsx", "margins.json"]
    document = json.loads(paths[2].read_text(encoding="utf-8"))
    assert document["schema"] == "shj-bayes/margins/1"
    assert len(document["margins"]) == len(sheet.rows)
    assert document["margins"][0]["value"] == pytest.approx(sheet.rows[0].value)
    cells = paths[0].read_text(encoding="utf-8").replace(",", "\n").splitlines()
    assert not any(cell.lstrip('"').startswith(("=", "+", "@")) for cell in cells)
    book = openpyxl.load_workbook(paths[1])
    assert book.sheetnames == ["Design", "All margins", "To mind"]
    assert book["All margins"].max_row == len(sheet.rows) + 1
    assert all(cell.data_type != "f" for page in book for row in page.iter_rows() for cell in row)
    assert to_json(sheet) == document
    assert to_table(sheet).shape[0] == len(sheet.rows)
    assert {"new device, low", "EN 1990 design, high"} <= set(design_table(sheet).columns)


def test_loops_as_values(population, sheet, tmp_path):
    bands = loops(population, sheet.motion)
    assert [(b.set_name, b.run) for b in bands[:2]] == [("Zinc 70", 1), ("Zinc 70", 2)]
    path = write_loops(bands, tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("set,n_devices,run,amplitude_mm,peak_speed_mm_s,displacement_mm,push_q05_kN")
    assert len(lines) == 1 + 121 * len(bands)
    assert write_loops((), tmp_path) is None
    assert not path.exists()


def test_a_number_without_origin_is_refused():
    with pytest.raises(PopulationError, match="lacks a clause"):
        Margin("s", "Fy", "m", "k", LOW, 1.0, "kN", 2, 1, "", "f", "i", "p")
    with pytest.raises(PopulationError, match="low, middle or high"):
        Margin("s", "Fy", "m", "k", "up", 1.0, "kN", 2, 1, "c", "f", "i", "p")


def test_bounds_do_not_contradict_each_other(sheet):
    assert "None contradict" in sheet.warnings[-1]
    for name in ("Zinc 70", "Zinc 70 corroded", LABEL):
        second = sheet.get(name, "Fy_second", "new device, 5 %", LOW).value
        force = sheet.get(name, "force", "new device, 95 %", HIGH).value
        for kind in ("ASCE 7 lower bound force", "EN 15129 LBDP, importance class II"):
            assert sheet.get(name, "Fy", kind, LOW).value <= second
        for kind in ("ASCE 7 upper bound force", "EN 15129 UBDP, importance class II"):
            assert sheet.get(name, "Fy", kind, HIGH).value >= 0.98 * force


def test_a_contradiction_is_found_and_said(sheet):
    bound = sheet.get("Zinc 70", "Fy", "EN 15129 LBDP, importance class II", LOW)
    second = sheet.get("Zinc 70", "Fy_second", "new device, 5 %", LOW)
    rows = [replace(r, value=second.value + 8.0) if r.key == bound.key else r for r in sheet.rows]
    found = agreement(rows)
    assert found.words.endswith("contradict.")
    assert "None" not in found.words
    assert any("EN 15129 LBDP" in t and "lies above new device, 5 % (Fy_second" in t for t in found.contradictions)
    assert agreement(sheet.rows).contradictions == ()


def test_a_spread_stated_as_known_is_printed_with_its_reason(population):
    told = margins(population, Request(v_known=0.06, v_reason="300 devices in the factory"))
    assert any("V = 0.06" in text and "300 devices in the factory" in text for text in told.warnings)
    row = told.get("Zinc 70", "Fy", "EN 1990 characteristic, lognormal, V known", LOW)
    assert "300 devices in the factory" in row.inputs
    assert told.get("Zinc 70", "K", "EN 1990 characteristic, lognormal, V known", LOW) is None
    line = design_table(told).query("set == 'Zinc 70' and quantity == 'Fy'").iloc[0]
    assert line["EN 1990 characteristic, low"] == pytest.approx(row.value)


def test_devices_of_one_set_are_not_independent_in_a_set_never_tested(sheet):
    row = sheet.get(ANY_SET, "Fy", "EN 1990 characteristic, lognormal, V between sets", LOW)
    assert row.n_devices == 5
    assert "set means" in row.inputs
    assert sheet.get(ANY_SET, "Fy", "EN 1990 characteristic, lognormal, V unknown", LOW) is None
