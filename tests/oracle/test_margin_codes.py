"""Every clause on numbers worked out by hand; the arithmetic stands in the tests."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import (
    NONE,
    Bounds,
    DesignBasis,
    Environment,
    SlidingForceBounds,
    force_ends,
    is_part,
    sliding_force_bounds,
)
from shj_bayes.margins.codes.bounds import ageing, warning, with_floor
from shj_bayes.margins.codes.code import Given, catalogue
from shj_bayes.margins.codes.tolerance import one_sided, two_sided
from shj_bayes.margins.spread import HIGH, LOW, Sample, between_sets, of_set
from shj_bayes.options import PLAIN, MarginOptions
from shj_bayes.population.predict import NewDevice

FORCE = SlidingForceBounds(
    third_low=70.0,
    third=80.0,
    third_high=92.0,
    first_low=66.0,
    later_low=52.0,
    low=51.0,
    high=97.0,
    typical=Bounds(0.78, 1.155),
    ratio=0.82,
)
AGE = Environment(Bounds(0.90, 1.0), Bounds(0.80, 1.05), "corroded over uncorroded")
PARTS = DesignBasis(80.0, "typical device", FORCE, AGE)
CODES = {code.id: code for code in catalogue()}
THREE = Sample(np.array([80.0, 84.0, 90.0]), 0.01)


def rows(code, request=PLAIN, sample=THREE, common=(math.nan, 0), parts=PARTS):
    given = Given("A", {"third": sample}, {"third": of_set(sample, common)}, {"third": sample.n}, parts, request)
    return {(row.kind, row.side): row for row in CODES[code].rows(given)}


def test_codes_are_found_in_the_tree():
    assert list(CODES) == ["en1990", "iso16269_6", "asce7", "en15129", "nz"]


def test_en1990_with_v_unknown_is_raised_to_a_tenth():
    """80, 84, 90 kN: y = 4.38203, 4.43082, 4.49981, m_y = 4.43755; deviations -0.05552, -0.00673, +0.06226.

    s^2 = (0.003082 + 0.000045 + 0.003876)/2 = 0.003502, V = 0.059 < 0.10, so s_y = sqrt(ln 1.01) = 0.099751.
    k_3 = 2.9200 sqrt(4/3) = 3.3717: X_k = exp(4.43755 - 0.33633) = exp(4.10122) = 60.41 kN.
    """
    row = rows("en1990")["EN 1990 characteristic, lognormal, V unknown", LOW]
    assert row.value == pytest.approx(60.41, abs=0.01)
    assert "V raised from 0.059 to 0.1" in row.note
    normal = rows("en1990")["EN 1990 characteristic, normal, V unknown", LOW]
    assert normal.value == pytest.approx(84.6667 * (1 - 3.3717 * 0.10), abs=0.01)  # 56.12 kN
    assert ("EN 1990 characteristic, lognormal, V known", LOW) not in rows("en1990")


def test_en1990_upper_values():
    """80, 84, 90 kN: V unknown exp(4.43755 + 0.33633) = 118.38 kN, V of 0.06 known exp(4.43755 + 0.11386) = 94.77."""
    found = rows("en1990", MarginOptions(v_known=0.06, v_reason="factory control of 300 devices"))
    assert found["EN 1990 characteristic, lognormal, V unknown", HIGH].value == pytest.approx(118.38, abs=0.02)
    assert found["EN 1990 characteristic, lognormal, V known", HIGH].value == pytest.approx(94.77, abs=0.01)


def test_en1990_with_a_spread_common_to_all_sets():
    """s_y = 0.12 with 5 degrees of freedom, mean of three: k = t(0.95; 5) sqrt(4/3) = 2.01505 x 1.15470 = 2.32678.

    X_k = exp(4.43755 - 2.32678 x 0.12) = exp(4.15834) = 63.97 kN, upper exp(4.71676) = 111.81 kN. k_d = t(0.999; 5)
    sqrt(4/3) = 5.89343 x 1.15470 = 6.80515: X_d = exp(4.43755 - 0.81662) = exp(3.62093) = 37.37 kN.
    """
    found = rows("en1990", common=(0.12, 5))
    assert found["EN 1990 characteristic, lognormal, V common", LOW].value == pytest.approx(63.97, abs=0.02)
    assert found["EN 1990 characteristic, lognormal, V common", HIGH].value == pytest.approx(111.81, abs=0.02)
    assert found["EN 1990 design, lognormal, V common", LOW].value == pytest.approx(37.37, abs=0.02)


def test_en1990_keeps_a_spread_wider_than_a_tenth():
    """60, 80, 110 kN: y = 4.09434, 4.38203, 4.70048, m_y = 4.39228; s^2 = (0.08878 + 0.00011 + 0.09499)/2 = 0.09193.

    s_y = 0.30321: X_k = exp(4.39228 - 3.3717 x 0.30321) = exp(3.36995) = 29.08 kN.
    """
    row = rows("en1990", sample=Sample(np.array([60.0, 80.0, 110.0]), 0.01))[
        "EN 1990 characteristic, lognormal, V unknown", LOW
    ]
    assert row.value == pytest.approx(29.08, abs=0.02)
    assert "raised" not in row.note


def test_en1990_with_v_known_is_what_the_user_states():
    """s_y = sqrt(ln(1 + 0.06^2)) = 0.059946; k_3 = 1.6449 sqrt(4/3) = 1.8993: exp(4.43755 - 0.11386) = 75.47 kN.

    k_d,3 = 3.0902 sqrt(4/3) = 3.5683: exp(4.43755 - 0.21391) = 68.28 kN.
    """
    request = MarginOptions(v_known=0.06, v_reason="factory control of 300 devices")
    found = rows("en1990", request)
    row = found["EN 1990 characteristic, lognormal, V known", LOW]
    assert row.value == pytest.approx(75.47, abs=0.01)
    assert found["EN 1990 design, lognormal, V known", LOW].value == pytest.approx(68.28, abs=0.01)
    assert "factory control of 300 devices" in row.inputs
    assert row.note == ""
    assert row.purpose.endswith("X_k, to be divided by gamma_m")
    assert "never divided" in found["EN 1990 characteristic, lognormal, V known", HIGH].purpose
    wide = rows("en1990", request, Sample(np.array([60.0, 80.0, 110.0]), 0.01))
    assert "spread more than the V stated" in wide["EN 1990 characteristic, lognormal, V known", LOW].note
    for half in ({"v_known": 0.06}, {"v_reason": "because"}):
        with pytest.raises(PopulationError, match="--v-known"):
            MarginOptions(**half)
    with pytest.raises(PopulationError, match="between 0 and 1"):
        MarginOptions(v_known=6.0, v_reason="per cent")


def test_tolerance_limits_keep_the_spread_as_measured():
    """k(3; 0.95, 0.95) = 7.6559: exp(4.43755 - 7.6559 x 0.05918) = exp(3.98447) = 53.76 kN; no floor in ISO 16269-6.

    Upper: exp(4.43755 + 0.45308) = exp(4.89063) = 133.04 kN.
    """
    found = rows("iso16269_6")
    low, high = (found["tolerance 95/95 one-sided, lognormal, V unknown", side] for side in (LOW, HIGH))
    assert (low.value, high.value) == pytest.approx((53.76, 133.04), abs=0.04)
    assert [row.purpose for row in (low, high)] == [
        f"95 % of devices lie {where} it, with a confidence of 95 %" for where in ("above", "below")
    ]


def test_tolerance_limits_with_v_known_need_no_degrees_of_freedom():
    """k = 1.64485 + 1.64485 / sqrt(3) = 2.59451: exp(4.43755 - 2.59451 x 0.059946) = exp(4.28202) = 72.39 kN.

    Both sides, n = 1, 90/95: the mean is off by 1.95996 at most, so k - 1.95996 = 1.28155 (the far tail holds 1e-5).
    """
    row = rows("iso16269_6", MarginOptions(v_known=0.06, v_reason="factory control of 300 devices"))[
        "tolerance 95/95 one-sided, lognormal, V known", LOW
    ]
    assert (row.value, row.degrees) == (pytest.approx(72.39, abs=0.01), math.inf)
    assert two_sided(1, 0.90, 0.95, degrees=math.inf) == pytest.approx(3.2415, abs=1e-3)
    k, off = two_sided(5, 0.95, 0.95, degrees=math.inf), 1.959964 / math.sqrt(5)
    assert stats.norm.cdf(off + k) - stats.norm.cdf(off - k) == pytest.approx(0.95, abs=1e-6)
    assert one_sided(5, 0.95, 0.95, degrees=1e6) == pytest.approx(one_sided(5, 0.95, 0.95, degrees=math.inf), rel=1e-3)


def test_en1990_design_value_from_four_devices():
    """70, 80, 90, 100 kN: y = 4.24850, 4.38203, 4.49981, 4.60517, m_y = 4.43388; deviations -0.18538, -0.05185,

    0.06593, 0.17129: s^2 = (0.034366 + 0.002688 + 0.004347 + 0.029340)/3 = 0.023580, s_y = 0.15356 > 0.0998: no floor.
    k_d,4 = t(0.999; 3) sqrt(1 + 1/4) = 10.2145 x 1.11803 = 11.4202 (Table D2: 11.40):
    X_d = exp(4.43388 - 11.4202 x 0.15356) = exp(2.68019) = 14.59 kN.
    """
    four = Sample(np.array([70.0, 80.0, 90.0, 100.0]), 0.01)
    row = rows("en1990", sample=four)["EN 1990 design, lognormal, V unknown", LOW]
    assert row.value == pytest.approx(14.59, abs=0.03)
    missing = rows("en1990")["EN 1990 design, lognormal, V unknown", LOW]
    assert math.isnan(missing.value)
    assert "no factor for n = 3" in missing.note


def test_tolerance_limits_of_both_sides_and_of_a_confidence_of_three_quarters():
    """Of 80, 84, 90 kN (m_y = 4.43755, s_y = 0.05918), with k(3; 0.95, 0.75) = 3.152 as printed in tables:

    exp(4.43755 - 3.152 x 0.05918) = exp(4.25101) = 70.18 kN. Two-sided 90/95, k = 8.306:
    exp(4.43755 -+ 8.306 x 0.05918) = exp(3.94600), exp(4.92910) = 51.73 and 138.26 kN.
    """
    found = rows("iso16269_6")
    assert found["tolerance 95/75 one-sided, lognormal, V unknown", LOW].value == pytest.approx(70.18, abs=0.03)
    low, high = (found["tolerance 90/95 two-sided, lognormal, V unknown", side].value for side in (LOW, HIGH))
    assert (low, high) == pytest.approx((51.73, 138.26), rel=2e-3)


def test_asce7_least_spread_is_assumed_where_the_tests_show_less():
    """Factors of 0.95 and 1.08 are nearer to 1 than 0.85 and 1.2 (dampers)."""
    assert with_floor(Bounds(0.95, 1.08)) == Bounds(0.85, 1.2)
    assert with_floor(Bounds(0.5897, 1.3283)) == Bounds(0.5897, 1.3283)


def test_asce7_bounds_with_the_floor():
    """Third cycle 78, 80, 82 kN; smallest plateau 77 (typical 0.975), largest force 84 kN (typical 1.03); no ageing.

    spec 78/80 = 0.975, 82/80 = 1.025; test,min the typical 0.975 (77/78 = 0.987), test,max 1.03 (84/82 = 1.024):
    min 0.9506, max 1.0558, both inside 0.85 and 1.2: 0.85 x 80 = 68 kN and 1.2 x 80 = 96 kN.
    """
    force = replace(
        FORCE, third_low=78.0, third_high=82.0, low=77.0, high=84.0, typical=Bounds(0.975, 1.03), first_low=77.0
    )
    parts = DesignBasis(80.0, "typical device", force, Environment(NONE, NONE, "not tested"))
    found = {kind: row.value for (kind, _), row in rows("asce7", parts=parts).items()}
    assert (found["lambda_min"], found["lambda_max"]) == pytest.approx((0.9506, 1.0558), abs=1e-4)
    assert (found["ASCE 7 lower bound force"], found["ASCE 7 upper bound force"]) == pytest.approx((68.0, 96.0))


def test_asce7_testing_holds_all_that_the_test_did():
    """Nominal 80 kN (third cycle).

    spec: 70/80 = 0.875, 92/80 = 1.150. test,min: typical 0.78, the 5 % devices 51/70 = 0.7286, so 0.7286; test,max:
    typical 1.155, the 95 % devices 97/92 = 1.054, so 1.155. ae,min 0.90.
    min = (1 - 0.75 x 0.10) x 0.7286 x 0.875 = 0.925 x 0.6375 = 0.5897, x 80 = 47.18 kN.
    max = 1 x 1.155 x 1.150 = 1.3283, x 80 = 106.26 kN.
    """
    found = {kind: row.value for (kind, _), row in rows("asce7").items()}
    assert (found["lambda_spec,min"], found["lambda_spec,max"]) == pytest.approx((0.875, 1.15))
    assert (found["lambda_test,min"], found["lambda_test,max"]) == pytest.approx((0.7286, 1.155), abs=1e-4)
    assert (found["lambda_ae,min"], found["lambda_ae,max"]) == pytest.approx((0.90, 1.0))
    assert (found["lambda_min"], found["lambda_max"]) == pytest.approx((0.5897, 1.3283), abs=1e-4)
    assert found["ASCE 7 lower bound force"] == pytest.approx(47.18, abs=0.01)
    assert found["ASCE 7 upper bound force"] == pytest.approx(106.26, abs=0.01)


def test_en15129_does_not_shrink_what_was_measured():
    """X = 51 and 97 kN, both runs and the speed in them: no psi. Ageing 0.90 measured in full, beyond it to 0.80 psi:

    0.90 x [1 + (0.80/0.90 - 1) x 0.70] = 0.90 x 0.92222 = 0.8300: LBDP = 51 x 0.83 = 42.33 kN.
    1 x [1 + (1.05 - 1) x 0.70] = 1.035: UBDP = 97 x 1.035 = 100.40 kN. Class III: 0.90 x (1 - 0.1) = 0.81: 41.31 kN.
    Class I: 0.90 x (1 - 0.1111 x 0.60) = 0.84: 42.84 kN, and 1.03 x 97 = 99.91 kN.
    """
    found = rows("en15129")
    assert found["EN 15129 LBDP, importance class II", LOW].value == pytest.approx(42.33)
    assert found["EN 15129 UBDP, importance class II", HIGH].value == pytest.approx(100.395)
    third = rows("en15129", MarginOptions(importance="III"))
    assert third["EN 15129 LBDP, importance class III", LOW].value == pytest.approx(41.31)
    first = rows("en15129", MarginOptions(importance="I"))
    assert first["EN 15129 LBDP, importance class I", LOW].value == pytest.approx(42.84)
    assert first["EN 15129 UBDP, importance class I", HIGH].value == pytest.approx(99.91)
    full = ageing(Environment(Bounds(0.5, 1.0), Bounds(0.5, 1.0), "exactly known"), "I")
    assert full.low == 0.5


def test_nz_equivalents_are_of_the_delivered_force_and_warn_beside_practice():
    """phi = 66/80 = 0.825 (practice 0.70: above), second run 52/80 = 0.65; phi_o = 97/80 = 1.2125 (practice 1.40)."""
    found = rows("nz")
    first = found["phi equivalent, first run", LOW]
    assert (first.value, first.warning) == (0.825, "above 0.70 of practice")
    second = found["phi equivalent, after a first earthquake", LOW]
    assert (second.value, second.warning) == (0.65, "0.70 not supported")
    assert [warning(value, HIGH) for value in (6.8, 1.40)] == ["1.40 not supported", ""]
    over = found["phi_o equivalent", HIGH]
    assert (over.value, over.warning) == (1.2125, "below 1.40 of practice")


def device(**draws):
    return {"default": NewDevice("A", 4, {q: np.array(v, dtype=float) for q, v in draws.items()})}


def test_delivered_force_is_read_off_the_design_quantities():
    """Smallest plateau 60 kN in the second run, largest force 90 in the first; third cycle 80: 60/80 and 90/80."""
    values = {
        "third": 80,
        "least": 75,
        "least_2": 60,
        "most": 90,
        "most_2": 70,
        "lowest": 60,
        "highest": 90,
        "ratio": 0.8,
    }
    found = sliding_force_bounds(
        device(**{name: [value] * 9 for name, value in values.items()}), dict.fromkeys(values, 9)
    )
    assert (found.first_low, found.later_low, found.low, found.high) == (75, 60, 60, 90)
    assert (found.third_low, found.third, found.third_high) == (80, 80, 80)
    assert (found.typical.low, found.typical.high, found.ratio) == pytest.approx((0.75, 1.125, 0.8))
    one_run = {name: [80.0] for name in ("third", "least", "most", "lowest", "highest")}
    assert sliding_force_bounds(device(**one_run), dict.fromkeys(one_run, 9)).later_low is None


def test_few_devices_take_the_outermost_prior():
    names = ("third", "least", "most", "lowest", "highest")
    priors = {
        label: NewDevice("A", 2, dict.fromkeys(names, np.array([value, value])))
        for label, value in {"default": 80.0, "alike": 70.0, "free": 95.0}.items()
    }
    few, many = (sliding_force_bounds(priors, dict.fromkeys(names, n)) for n in (3, 4))
    assert (few.low, few.third, few.high) == (70, 80, 95)
    assert (many.low, many.third, many.high) == (80, 80, 80)


def test_no_part_passes_the_whole():
    """Zinc 100 of the tables: the second run alone gave 441 kN where the largest force of all runs gave 158.

    95 % of 1 ... 100 is 95.05, of 1 ... 400 in 100 steps 380.2; whole 60 ... 159: 154.05. The parts are held to it, and
    the whole stays what it is said to be. Where half of the devices had no second run, the whole knows it of half of
    them, so the second run counts besides.
    """
    wide, whole = np.linspace(4.0, 400.0, 100), np.linspace(60.0, 159.0, 100)
    draws = {"lowest": whole / 9, "least": whole / 8, "least_2": wide / 50, "third": whole / 6, "most": whole * 0.9}
    one = device(**draws, plateau=whole / 7, plateau_2=wide / 2, most_2=wide, highest=whole)
    tested = dict.fromkeys(one["default"].draws, 4)
    ends = force_ends(one, tested)
    assert (ends["highest", HIGH], ends["most_2", HIGH]) == ((154.05, 154.05), (154.05, pytest.approx(380.2)))
    assert ends["lowest", LOW][0] == pytest.approx(64.95 / 9)
    assert ends["least_2", LOW] == (ends["lowest", LOW][0], pytest.approx(23.8 / 50))
    for (a, side), (value, _) in ends.items():
        assert all(value <= ends[b, side][0] for b in one["default"].draws if is_part(a, b))
    half = sliding_force_bounds(one, tested | dict.fromkeys(("least_2", "plateau_2", "most_2"), 2))
    assert (half.low, half.high) == pytest.approx((23.8 / 50, 380.2))


def test_a_set_never_tested_uses_the_spread_between_sets():
    """Two devices in each of three sets: 80, 80; 100, 100; 125, 125 kN. Logarithms of the means: steps of ln 1.25.

    s_m = 0.22314, nothing within, so s = 0.22314 with 2 degrees of freedom; k = 2.9200 sqrt(4/3) = 3.3717:
    X_k = 100 exp(-3.3717 x 0.22314) = 47.12 kN. As six independent devices it would have been
    s = 0.19958, k_6 = 2.1765: 64.8 kN.
    """
    sample, (way,) = between_sets([Sample(np.array([x, x]), 0.0) for x in (80.0, 100.0, 125.0)])
    assert (sample.n, way.degrees, way.n_mean) == pytest.approx((3, 2, 3))
    assert way.sd_log == pytest.approx(0.22314, abs=1e-5)
    assert 100 * math.exp(-3.3717 * way.sd_log) == pytest.approx(47.12, abs=0.01)
    assert between_sets([Sample(np.array([80.0, 82.0]), 0.0)])[1] == ()


def test_tolerance_limits_hold_where_devices_cluster_in_sets():
    """95/95 over 8 sets of 3, between 0.2 and within 0.1: held in 93 % of campaigns or more, by devices alone not."""
    rng, n = np.random.default_rng(5), 2000
    held = alone = 0
    limit = math.hypot(0.2, 0.1)
    for _ in range(n):
        y = 0.2 * rng.standard_normal((8, 1)) + 0.1 * rng.standard_normal((8, 3))
        sample, (way,) = between_sets([Sample(np.exp(row), 0.0) for row in y])
        k = one_sided(round(way.n_mean, 1), 0.95, 0.95, round(way.degrees, 1))
        held += stats.norm.sf((sample.mean_log - k * way.sd_log) / limit) >= 0.95
        low = y.mean() - one_sided(24, 0.95, 0.95) * y.std(ddof=1)
        alone += stats.norm.sf(low / limit) >= 0.95
    assert held / n >= 0.93
    assert alone / n < 0.85


def test_a_pair_of_factors_holds_one():
    assert Bounds.around(0.8, 1.3) == Bounds(0.8, 1.3)
    assert Bounds.around(1.2) == Bounds(1.0, 1.2)
    assert Bounds(1.0, 1.0) == NONE
