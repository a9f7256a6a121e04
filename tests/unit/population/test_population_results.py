import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from shj_bayes.errors import PopulationError
from shj_bayes.population.compare import compare
from shj_bayes.population.device import DeviceEstimate
from shj_bayes.population.hierarchy import ANY_SET, N_DRAWS, fit_population
from shj_bayes.population.predict import NewDevice, dep_words, how_wide, loop_band, new_device, new_device_table
from shj_bayes.population.quantities import rounded, to_step
from shj_bayes.population.results import load_population, record_of, write_population
from shj_bayes.report.sets import contrast_words
from shj_bayes.results.codec import to_json
from shj_bayes.results.tables import safe_cell

ALKYD = "=cmd|' /C calc'!A0"


def test_bands_are_ordered_and_hold_the_tested_devices(result):
    table = pd.DataFrame(new_device_table(result))
    assert (table["q05"] < table["q50"]).all()
    assert (table["q50"] < table["q95"]).all()
    assert set(table["quantity"]) == {"K", "Fy", "ratio", "gamma", "beta", "Fy_second"}
    assert set(table["set"]) == {"Zinc 70", ALKYD, "Brass", ANY_SET}
    force = table[table["quantity"] == "Fy"].set_index("set")
    assert force.loc["Zinc 70", "q05"] < 90 < force.loc["Zinc 70", "q95"]
    assert force.loc[ALKYD, "q05"] < 50
    assert force.loc[ALKYD, "q95"] > 75
    assert force.loc[ANY_SET, "n_devices"] == 0
    assert np.isfinite(table.select_dtypes("number").to_numpy()).all()


def test_few_devices_are_said_to_be_few(result):
    assert "says nothing about its spread" in how_wide(result, "Brass")
    assert "Two devices are not a band" in how_wide(result, "Zinc 70")
    assert "A set never tested" in how_wide(result, ANY_SET)
    for words in ("if all sets are held to spread nearly alike", "if the spread is left to the devices alone"):
        assert words in how_wide(result, "Zinc 70")


def test_dep_is_only_words_beside_gamma(result):
    assert dep_words(-0.02, 0.01) == "below -50 or above 100 mm/s; no dependence is inside the band"
    assert dep_words(0.01, 0.02) == "50 to 100 mm/s"
    assert dep_words(-0.02, -0.01) == "-100 to -50 mm/s"
    table = pd.DataFrame(new_device_table(result))
    assert (table.loc[table["quantity"] != "gamma", "dep_mm_s"] == "").all()


def test_predictions_are_reproducible(result):
    first, again = new_device(result, "Brass"), new_device(result, "brass")
    assert np.array_equal(first.draws["Fy"], again.draws["Fy"])


def test_unknown_set_names_the_nearest(result):
    with pytest.raises(PopulationError, match="did you mean 'Zinc 70'"):
        new_device(result, "Zink 70")
    with pytest.raises(PopulationError, match="sets are: 'Zinc 70'"):
        new_device(result, "qqqq")
    with pytest.raises(PopulationError, match="no prior 'narrow'"):
        new_device(result, "Brass", "narrow")


def test_comparison_is_antisymmetric_and_never_says_no_effect(result):
    forward, back = compare(result, "Zinc 70", ALKYD), compare(result, ALKYD, "Zinc 70")
    for a, b in zip(forward, back, strict=True):
        assert a.superiority == pytest.approx(1 - b.superiority)
        assert a.probability_level == pytest.approx(1 - b.probability_level)
        if a.kind == "quotient":
            assert (a.q05, a.q95) == pytest.approx((1 / b.q95, 1 / b.q05))
        else:
            assert (a.q05, a.q95) == pytest.approx((-b.q95, -b.q05))
        assert "no effect" not in contrast_words(a, "Zinc 70", ALKYD)
        assert "with 2 and 2 devices" in contrast_words(a, "Zinc 70", ALKYD)
        assert set(a.other_priors) == {"alike", "free"}
    assert len(forward) == 5
    force = next(c for c in forward if c.quantity == "Fy")
    assert force.superiority > 0.7
    points = [list(s.points["Fy"]) for s in result.sets[:2]]
    assert force.tests.welch_p == pytest.approx(
        stats.ttest_ind(np.add(points[0], [0, 1e-12]), points[1], equal_var=False).pvalue
    )
    assert compare(result, "Brass", ALKYD)[0].tests.welch_p is None


def test_comparison_with_itself_is_refused(result):
    with pytest.raises(PopulationError, match="with itself"):
        compare(result, "Brass", "brass")


def test_files_come_back_as_they_were(result, tmp_path):
    write_population(result, tmp_path)
    again = load_population(tmp_path)
    assert again.set_names == result.set_names
    assert again.sets[1].tags == result.sets[1].tags
    assert new_device_table(again) == new_device_table(result)
    document = json.loads((tmp_path / "population.json").read_text())
    assert document["schema"] == "shj-bayes/population/1"
    assert [s["n_devices"] for s in document["sets"]] == [2, 2, 1, 0]
    write_population(again, tmp_path / "twice")
    for name in ("population.csv", "population.json"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "twice" / name).read_bytes()


def test_names_cannot_become_spreadsheet_formulas(result, tmp_path):
    write_population(result, tmp_path)
    cells = (tmp_path / "population.csv").read_text().replace(",", "\n").splitlines()
    assert any(cell.startswith("'=cmd") for cell in cells)
    assert not any(cell.lstrip('"').startswith(("=", "+", "@")) for cell in cells)
    assert [safe_cell(v) for v in ("=1", "+1", "-x", "@a", "\tz", " =1", "Brass", "", -1.0)] == [
        "'=1",
        "'+1",
        "'-x",
        "'@a",
        "'\tz",
        "' =1",
        "Brass",
        "",
        -1.0,
    ]


def test_a_folder_without_a_population_is_refused(tmp_path):
    with pytest.raises(PopulationError, match=r"holds no population\.json"):
        load_population(tmp_path)
    (tmp_path / "population.json").write_text('{"schema": "other"}')
    np.savez(tmp_path / "population.npz", x=np.zeros(1))
    with pytest.raises(PopulationError, match=r"none of the schemas shj-bayes/population/1"):
        load_population(tmp_path)


def test_tables_say_what_they_rest_on(result):
    rows = to_json(record_of(result))["quantities"]
    assert all(row["draws"] == N_DRAWS and row["prior"] for row in rows)


def test_loop_of_one_law_is_the_law_itself():
    """No spread: the band closes on the rigid-plastic loop, whose energy is known."""
    n, amplitude, v0, gamma = 20, 50.0, 10.0, 1 / 60
    draws = {"K": np.full(n, 1e5), "Fy": np.full(n, 80.0), "beta": np.full(n, 200.0), "gamma": np.full(n, gamma)}
    band = loop_band(NewDevice("s", 3, draws), amplitude_mm=amplitude, peak_speed_mm_s=v0)
    assert np.allclose(band.push[0], band.push[2])
    assert band.push[1][60] == pytest.approx(80 * (1 + gamma * v0), rel=1e-3)
    assert band.pull[1][60] == pytest.approx(-80 * (1 + gamma * v0), rel=1e-3)
    exact = 4 * amplitude * 80 * (1 + np.pi / 4 * v0 * gamma)
    assert band.energy_kN_mm[1] == pytest.approx(exact, rel=5e-3)


def test_loops_of_a_set(result):
    device = new_device(result, ALKYD)
    first, second = (loop_band(device, amplitude_mm=48.0, run=run) for run in (1, 2))
    assert np.all(first.push[0] <= first.push[2])
    assert second.energy_kN_mm[1] < first.energy_kN_mm[1]
    assert first.n_devices == 2


def test_loops_refuse_what_cannot_be(result):
    device = new_device(result, "Brass")
    with pytest.raises(PopulationError, match="above zero"):
        loop_band(device, amplitude_mm=-1.0)
    with pytest.raises(PopulationError, match="run 1 or 2"):
        loop_band(device, amplitude_mm=10.0, run=3)
    only = NewDevice("s", 1, {"K": np.ones(3), "Fy": np.ones(3)})
    with pytest.raises(PopulationError, match=r"needs Fy_second, beta, gamma.*two runs"):
        loop_band(only, amplitude_mm=10.0, run=2)


def test_a_quantity_that_some_sets_lack_rests_on_the_others(devices):
    devices = [
        DeviceEstimate("a", "one run", {"Fy": rounded("Fy", to_step(80, 5))}),
        *(d for d in devices if d.set_name == "Zinc 70"),
        DeviceEstimate("a", "stiffness alone", {"K": rounded("K", to_step(20, 1))}),
    ]
    result = fit_population(devices, seed=1)
    table = pd.DataFrame(new_device_table(result)).set_index(["set", "quantity"])
    assert table.loc[("one run", "ratio"), "n_devices"] == 0
    assert table.loc[("one run", "Fy_second"), "n_devices"] == 0
    assert table.loc[("one run", "ratio"), "width"] > table.loc[("Zinc 70", "ratio"), "width"]
    assert "No device of stiffness alone gives Fy" in how_wide(result, "stiffness alone")
    with pytest.raises(PopulationError, match="no device gives 'beta'"):
        fit_population(devices[:1], seed=1).fit("beta")
