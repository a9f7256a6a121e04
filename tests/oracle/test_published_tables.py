"""The shipped tables against an independent audit of the paper."""

import numpy as np
import pytest

from shj_bayes.population.device import published_devices, published_rows, read_table
from shj_validation.paper_claims import (
    coated_table,
    degradation_counts,
    losses_percent,
    pair_spread,
    paper_claims,
)

LOSS = {  # loss of sliding force, per cent, audited by hand from the printed tables
    3: {"Brass": 28.6, "Aluminium": 10.0, "Bisalloy 80": 28.6, "Bisalloy 400": 7.7, "Bisalloy 500": 12.5},
    4: {"Sweep blasted": 21.1, "Alkyd 70": 13.3, "Alkyd 100": 60.0, "Zinc 70": 33.3, "Zinc 100": 33.3},
    5: {"Sweep blasted": 21.1, "Alkyd 70": 13.3, "Alkyd 100": 40.0, "Zinc 70": 22.2, "Zinc 100": 80.0},
    6: {"Sweep blasted": 7.7, "Alkyd 70": 30.9, "Alkyd 100": 47.1, "Zinc 70": 9.7, "Zinc 100": 20.0},
    7: {"Sweep blasted": 16.7, "Alkyd 70": 30.9, "Alkyd 100": 27.3, "Zinc 70": 9.7, "Zinc 100": 40.0},
}
FORCES = {  # first run, second run, kN
    (3, "Brass"): (70, 50),
    (3, "Bisalloy 400"): (65, 60),
    (4, "Alkyd 70"): (90, 78),
    (5, "Zinc 100"): (50, 10),
    (6, "Alkyd 100"): (85, 45),
    (7, "Alkyd 100"): (22, 16),
}
STIFFNESS = {
    3: (18, 17.5, 20, 22, 18),
    4: (12, 15, 8, 10, 10),
    5: (14, 15, 12, 13, 10),
    6: (12, 12, 18, 18, 15),
    7: (15, 12, 6, 18, 15),
}
DEP = {
    3: (30, 60, 60, 30, 60),
    4: (-90, -30, 30, -90, -90),
    5: (-120, -30, -60, -60, -100),
    6: (-60, -60, -150, 90, 90),
    7: (-60, -60, -150, -90, -90),
}
ROWS = published_rows()
CLAIMS = {claim.id: claim for claim in paper_claims()}


def test_there_are_25_devices_in_15_sets():
    assert len(ROWS) == 25
    assert [row.table for row in ROWS] == [t for t in (3, 4, 5, 6, 7) for _ in range(5)]
    sizes = {}
    for device in published_devices():
        sizes[device.set_name] = sizes.get(device.set_name, 0) + 1
    assert sorted(sizes.values()) == [1] * 5 + [2] * 10


@pytest.mark.parametrize("table", LOSS)
def test_degradation_of_every_row(table):
    found = {row.row: round(100 * (1 - row.ratio), 1) for row in ROWS if row.table == table}
    assert found == LOSS[table]


def test_printed_values():
    for row in ROWS:
        if (row.table, row.row) in FORCES:
            assert (row.values["Fy", 1], row.values["Fy", 2]) == FORCES[row.table, row.row]
        assert row.values["beta", 1] == (100 if row.table == 3 else 10)
    for table in LOSS:
        rows = [row for row in ROWS if row.table == table]
        assert tuple(row.values["K", 1] for row in rows) == STIFFNESS[table]
        assert tuple(row.values["dep", 1] for row in rows) == DEP[table]


def test_rows_that_repeat_a_table_are_marked_and_left_out():
    repeats = [line for t in (4, 5) for line in read_table(t) if line["repeats_table"]]
    assert {line["row"] for line in repeats} == {"Uncoated Bisalloy 500"}
    assert not any(row.row.startswith("Uncoated") for row in ROWS)
    original = {(x["run"], x["quantity"]): x["value"] for x in read_table(3) if x["row"] == "Bisalloy 500"}
    assert all(original[x["run"], x["quantity"]] == x["value"] for x in repeats)


def test_every_number_has_unit_and_rounding_step():
    for table in (3, 4, 5, 6, 7):
        for line in read_table(table):
            assert line["unit"] == {"K": "kN/mm", "Fy": "kN", "beta": "1", "dep": "mm/s"}[line["quantity"]]
            assert float(line["rounding_step"]) > 0
            assert line["rounding_scale"] == ("log10" if line["quantity"] == "beta" else "linear")


def test_table_1_holds_the_printed_regime_and_says_where_it_contradicts_the_text():
    column = {}
    for line in read_table(1):
        column.setdefault(line["quantity"], []).append(float(line["value"]))
    assert column["cycles"] == [3, 3, 3, 3, 3, 6]
    speed = 2 * np.pi * np.array(column["frequency"]) * np.array(column["amplitude"])
    assert (round(speed.min(), 2), round(speed.max(), 2)) == (9.80, 10.25)
    travel = 4 * np.array(column["amplitude"]) @ np.array([3, 3, 3, 3, 3, 5]) / 1000
    assert round(travel, 3) == 3.844
    assert any("5 is assumed" in line["note"] for line in read_table(1))


def test_means_and_counts_of_the_audit():
    loss = losses_percent(ROWS)
    table = np.array([row.table for row in ROWS])
    assert [round(loss[table == t].mean(), 1) for t in LOSS] == [17.5, 32.2, 35.3, 23.1, 24.9]
    assert degradation_counts(ROWS) == (5, 5, 6, 6, 1, 1, 1)
    rounded = np.round(loss, -1)
    assert [int(np.sum(rounded == x)) for x in (10, 20, 30, 40, 50, 60, 80)] == [8, 5, 7, 2, 1, 1, 1]


@pytest.mark.parametrize(
    ("quantity", "run", "both", "first", "second"),
    [("K", 1, 0.275, 0.160, 0.355), ("Fy", 1, 0.342, 0.226, 0.428), ("Fy", 2, 0.504, 0.624, 0.344)],
)
def test_spread_within_pairs(quantity, run, both, first, second):
    found = [pair_spread(lambda row: row.values[quantity, run], ROWS, which) for which in (None, 0, 1)]
    assert np.round(found, 3).tolist() == [both, first, second]


def test_spread_of_the_ratio_within_pairs():
    found = [pair_spread(lambda row: row.ratio, ROWS, which) for which in (None, 0, 1)]
    assert np.round(found, 3).tolist() == [0.303, 0.405, 0.139]


def test_pairs_identical_to_the_digit():
    for quantity, run, expected in (("Fy", 1, 6), ("Fy", 2, 4), ("K", 1, 5)):
        values = coated_table(lambda row, q=quantity, r=run: row.values[q, r], ROWS)
        assert int(np.sum(values[..., 0] == values[..., 1])) == expected


def test_claims_on_degradation():
    assert CLAIMS["most_20_to_30"].values["rows_20_to_30"] == 7
    assert CLAIMS["most_below_30"].values["rows_up_to_30"] == 16
    assert CLAIMS["most_below_30"].values["rows_above_30"] == 9
    assert CLAIMS["counts_of_figure_10"].values == {"tables": (3, 4, 6), "matching_choices": 1}
    assert CLAIMS["up_to_60"].values == {"worst_percent": 80.0, "table": 5}


def test_claims_on_corrosion_and_coating():
    corrosion = CLAIMS["corrosion_no_effect"]
    assert np.round(corrosion.values["change_percent_per_coating"]).tolist() == [-34, -39, -29, -20, 12]
    assert round(corrosion.values["mean_change_percent"]) == -24
    assert round(corrosion.values["permutation_p_log"], 3) == 0.062
    assert corrosion.values["arrangements"] == 7776
    assert round(corrosion.values["anova_f_log"], 2) == 3.21
    assert round(corrosion.values["anova_p_log"], 2) == 0.10
    coating = CLAIMS["coating_matters"].values
    assert [round(coating[k], 2) for k in ("f_force_log", "f_ratio_log", "f_gamma")] == [1.05, 2.42, 2.18]
    assert [round(coating[k], 2) for k in ("p_force_log", "p_ratio_log", "p_gamma")] == [0.43, 0.12, 0.15]
    assert corrosion.verdict == "not settled"


def test_claims_on_velocity_and_runs():
    assert CLAIMS["coatings_turn_negative"].values["negative_per_table"] == (0, 4, 5, 3, 5)
    assert CLAIMS["unchanged_between_runs"].values["rows_identical"] == 25
    assert CLAIMS["average_of_dep"].values == {"sum_of_dep": 0.0, "mean_gamma": 0.0}
    assert CLAIMS["slight_differences"].values["pairs_identical_Fy"] == 6


def test_every_claim_is_said_in_words():
    for claim in CLAIMS.values():
        assert claim.verdict in {"holds", "holds in part", "does not hold", "not settled"}
        assert claim.sentence.endswith(".")
        assert "no effect" not in claim.sentence.lower()
