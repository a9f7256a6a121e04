"""Factors of codes and standards against printed tables and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import Bounds
from shj_bayes.margins.codes import bounds, tolerance
from shj_bayes.margins.export import SHARPEST, exponent_of_steel02, wen_exponent
from shj_bayes.margins.history import sine
from shj_bayes.margins.specimen import drive
from shj_bayes.margins.spread import HIGH, LOGNORMAL, LOW, NORMAL, Sample, Spread, limit, sd_of_log, variation_of_log
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.history import histories
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import published_rows
from shj_bayes.population.readings import of_readings, read_off
from shj_validation.paper_claims import pair_spread

# EN 1990 Annex D, as printed
D1_KNOWN = {1: 2.31, 2: 2.01, 3: 1.89, 4: 1.83, 5: 1.80, 6: 1.77, 8: 1.74, 10: 1.72, 20: 1.68, 30: 1.67}
D1_UNKNOWN = {3: 3.37, 4: 2.63, 5: 2.33, 6: 2.18, 8: 2.00, 10: 1.92, 20: 1.76, 30: 1.73}
D1_KNOWN_EXACT = {1: 2.3262, 2: 2.0145, 3: 1.8993, 4: 1.8390, 5: 1.8018, 6: 1.7766, 8: 1.7446, 10: 1.7251, 20: 1.6855}
D1_UNKNOWN_EXACT = {
    2: 7.7327,
    3: 3.3717,
    4: 2.6311,
    5: 2.3353,
    6: 2.1765,
    8: 2.0095,
    10: 1.9226,
    20: 1.7718,
    30: 1.7272,
}
D2_KNOWN = {1: 4.36, 2: 3.77, 3: 3.56, 4: 3.44, 5: 3.37, 6: 3.33, 8: 3.27, 10: 3.23, 20: 3.16, 30: 3.13}
D2_UNKNOWN = {4: 11.40, 5: 7.85, 6: 6.36, 8: 5.07, 10: 4.51, 20: 3.64, 30: 3.44}
D2_UNKNOWN_EXACT = {4: 11.420, 5: 7.858, 6: 6.366, 8: 5.076, 10: 4.507, 20: 3.668, 30: 3.452}

# one-sided .95/.75, .95/.90, .95/.95, .90/.95, .99/.95; two-sided .90/.95, .95/.95, .99/.95
ONE = ((0.95, 0.75), (0.95, 0.90), (0.95, 0.95), (0.90, 0.95), (0.99, 0.95))
TWO = (0.90, 0.95, 0.99)
LIMITS = {
    2: (5.1215, 13.0897, 26.2597, 20.5815, 37.0936, 31.0922, 36.5192, 46.9444),
    3: (3.1518, 5.3115, 7.6559, 6.1553, 10.5527, 8.3059, 9.7888, 12.6471),
    4: (2.6806, 3.9566, 5.1439, 4.1619, 7.0424, 5.3681, 6.3411, 8.2207),
    5: (2.4634, 3.3998, 4.2027, 3.4066, 5.7411, 4.2906, 5.0769, 6.5980),
    6: (2.3356, 3.0919, 3.7077, 3.0063, 5.0620, 3.7326, 4.4222, 5.7577),
    8: (2.1883, 2.7543, 3.1873, 2.5819, 4.3539, 3.1560, 3.7455, 4.8892),
    10: (2.1037, 2.5684, 2.9110, 2.3546, 3.9811, 2.8563, 3.3934, 4.4369),
    20: (1.9320, 2.2078, 2.3960, 1.9260, 3.2952, 2.3188, 2.7603, 3.6210),
    30: (1.8686, 2.0798, 2.2198, 1.7773, 3.0639, 2.1451, 2.5549, 3.3546),
}
PRINTED_TWO_SIDED = {  # Statistics for Environmental Engineers, Table 21.1, confidence 95 %
    4: (5.37, 6.34, 8.22),
    5: (4.29, 5.08, 6.60),
    6: (3.73, 4.42, 5.76),
    7: (3.39, 4.02, 5.24),
    8: (3.16, 3.75, 4.89),
    9: (2.99, 3.55, 4.63),
    10: (2.86, 3.39, 4.44),
    12: (2.67, 3.17, 4.16),
    15: (2.49, 2.96, 3.89),
    20: (2.32, 2.76, 3.62),
    25: (2.22, 2.64, 3.46),
    30: (2.15, 2.55, 3.35),
    40: (2.06, 2.45, 3.22),
    60: (1.96, 2.34, 3.07),
}


@pytest.mark.parametrize("n", D1_KNOWN)
def test_en1990_variation_known(n):
    assert tolerance.factor_known(n) == pytest.approx(D1_KNOWN[n], abs=0.02)
    assert tolerance.factor_known(n, tolerance.DESIGN) == pytest.approx(D2_KNOWN[n], abs=0.03)
    if n in D1_KNOWN_EXACT:
        assert tolerance.factor_known(n) == pytest.approx(D1_KNOWN_EXACT[n], abs=1e-4)


@pytest.mark.parametrize("n", D1_UNKNOWN_EXACT)
def test_en1990_variation_unknown(n):
    assert tolerance.factor_unknown(n) == pytest.approx(D1_UNKNOWN_EXACT[n], abs=1e-4)
    if n in D1_UNKNOWN:
        assert tolerance.factor_unknown(n) == pytest.approx(D1_UNKNOWN[n], abs=0.02)
    if n in D2_UNKNOWN:
        assert tolerance.factor_unknown(n, tolerance.DESIGN) == pytest.approx(D2_UNKNOWN[n], abs=0.03)
        assert tolerance.factor_unknown(n, tolerance.DESIGN) == pytest.approx(D2_UNKNOWN_EXACT[n], abs=6e-4)


def test_en1990_limits_and_design_level():
    assert tolerance.factor_known(10**9) == pytest.approx(1.6449, abs=1e-4)
    fractile = float(stats.norm.sf(3.04))
    found = [tolerance.factor_unknown(n, fractile) for n in (4, 5, 6, 8, 10)]
    assert found == pytest.approx([10.784, 7.514, 6.129, 4.923, 4.387], abs=1e-3)


def test_en1990_pooled_spread_of_the_paper():
    """Factors and bands about a coating's mean of 2.7, from the published pairs."""
    assert tolerance.factor_unknown(2, degrees=5) == pytest.approx(2.4679, abs=1e-4)
    k = tolerance.factor_unknown(2, degrees=10)
    assert k == pytest.approx(2.2198, abs=1e-4)
    rows = published_rows()
    wanted = {"Fy1": (0.47, 2.14), "Fy2": (0.33, 3.06), "ratio": (0.51, 1.96), "K": (0.54, 1.84)}
    value = {
        "Fy1": lambda row: row.values["Fy", 1],
        "Fy2": lambda row: row.values["Fy", 2],
        "ratio": lambda row: row.ratio,
        "K": lambda row: row.values["K", 1],
    }
    for name, band in wanted.items():
        sd = pair_spread(value[name], rows)
        found = [math.exp(side * k * sd) for side in (-1, 1)]
        assert found == pytest.approx(band, abs=0.006)


def test_en1990_values():
    alone, way = Sample(np.array([80.0]), 0.0), Spread("V", 0.1, 0.1, 3, 1, "stated")
    assert limit(alone, way, 2.0, NORMAL, LOW)[0] == pytest.approx(64.0)
    assert limit(alone, way, 2.0, NORMAL, HIGH)[0] == pytest.approx(96.0)
    assert limit(alone, way, 2.0, LOGNORMAL, LOW)[0] == pytest.approx(80 * math.exp(-0.2))
    assert sd_of_log(0.1) == pytest.approx(math.sqrt(math.log(1.01)))
    assert variation_of_log(sd_of_log(0.37)) == pytest.approx(0.37)
    with pytest.raises(PopulationError, match="two devices of one set"):
        tolerance.factor_unknown(1)


@pytest.mark.parametrize("n", LIMITS)
def test_tolerance_factors(n):
    found = [tolerance.one_sided(n, *p) for p in ONE] + [tolerance.two_sided(n, p, 0.95) for p in TWO]
    assert found == pytest.approx(LIMITS[n], abs=1.01e-4)


@pytest.mark.parametrize("n", PRINTED_TWO_SIDED)
def test_two_sided_factors_as_printed(n):
    found = [tolerance.two_sided(n, p, 0.95) for p in TWO]
    assert found == pytest.approx(PRINTED_TWO_SIDED[n], abs=0.0051)


def test_tolerance_worked_example():
    """NIST, n = 43, 90 % with 99 % confidence; the handbook's own k2 (Howe) and k1 (Natrella) are approximations."""
    assert tolerance.two_sided(43, 0.90, 0.99) == pytest.approx(2.2228, abs=1e-4)
    assert tolerance.one_sided(43, 0.90, 0.99) == pytest.approx(1.8740, abs=1e-4)
    assert pytest.approx((97.010576, 97.12942), abs=1e-5) == (97.07 - 2.2173 * 0.0268, 97.07 + 2.2173 * 0.0268)


def test_tolerance_limits_for_many_devices_and_known_spread():
    assert tolerance.two_sided(10**6, 0.95, 0.95) == pytest.approx(1.96, abs=0.005)
    pooled = tolerance.one_sided(2, 0.95, 0.95, 10**7)
    assert pooled == pytest.approx(1.6449 + 1.6449 / math.sqrt(2), abs=1e-3)


def test_common_variance_covers_what_it_says():
    """Ten sets of two with one variance: the limits of set 1 hold 95 % of devices in 95 % of campaigns."""
    one, two = tolerance.one_sided(2, 0.95, 0.95, 10), tolerance.two_sided(2, 0.90, 0.95, 10)
    x = np.random.default_rng(41).standard_normal((40_000, 10, 2))
    mean, sd = x[:, 0].mean(axis=1), np.sqrt(x.var(axis=2, ddof=1).mean(axis=1))
    held = stats.norm.sf(mean - one * sd) >= 0.95
    both = stats.norm.cdf(mean + two * sd) - stats.norm.cdf(mean - two * sd) >= 0.90
    error = math.sqrt(0.95 * 0.05 / 40_000)
    assert held.mean() == pytest.approx(0.95, abs=4 * error)
    assert both.mean() == pytest.approx(0.95, abs=4 * error)
    alone = tolerance.one_sided(2, 0.95, 0.95)  # the factor for a set's own spread must not be right here
    assert (stats.norm.sf(mean - alone * sd) >= 0.95).mean() > 0.99


def test_tolerance_refuses_what_cannot_be():
    with pytest.raises(PopulationError, match="two devices of one set"):
        tolerance.one_sided(1, 0.95, 0.95)


def test_asce7():
    total = bounds.modification(Bounds(1.0, 1.56), Bounds(0.7, 1.3), Bounds(0.85, 1.15))
    assert (total.low, total.high) == pytest.approx((0.595, 2.1229), abs=1e-4)
    assert bounds.with_floor(Bounds(0.9, 1.1)) == Bounds(0.85, 1.2)
    assert bounds.with_floor(Bounds(0.5, 2.0)) == Bounds(0.5, 2.0)
    assert Bounds.around(0.8, 1.3) == Bounds(0.8, 1.3)
    with pytest.raises(PopulationError, match="lower <= 1"):
        Bounds(1.1, 1.2)


def test_en15129():
    assert [bounds.combined(2.0, c) for c in ("III", "II", "I")] == pytest.approx([1.9, 1.7, 1.6])
    with pytest.raises(PopulationError, match="I, II or III"):
        bounds.combined(1.0, "IV")


def test_new_zealand_practice():
    assert bounds.equivalent_factors(56.0, 112.0, 80.0) == pytest.approx((bounds.PRACTICE_PHI, bounds.PRACTICE_PHI_O))
    with pytest.raises(PopulationError, match="above zero"):
        bounds.equivalent_factors(1.0, 2.0, 0.0)


def of_a_sine(K, Fy, beta, gamma):
    """Design quantities of one device in three cycles of 95 mm at 10 mm/s."""
    asked, model = sine(95.0, 10.0, 3), DeviceModel(1, read_priors())
    values = {"K": K, "Fy": Fy, "beta": beta, "gamma": gamma}
    theta = np.array([[values.get(name, 1.0) for name in model.names]])
    (history,) = histories([asked.time_s], [asked.motion])
    (force,) = drive(model, theta, [history])
    found = of_readings(read_off(force, asked.motion, history.travel_m), 95.0)
    return {name: float(value[0]) for name, value in found.items()}


@pytest.mark.parametrize(
    ("dep", "factor"),
    [(30, 1.2618), (60, 1.1309), (-30, 0.7382), (-60, 0.8691), (-90, 0.9127), (-120, 0.9346), (-150, 0.9476)],
)
def test_energy_of_a_sine_with_the_speed_law(dep, factor):
    """Rigid limit: E = 4 A Fy (1 + pi/4 v0/dep). Mean of the speed over the middle half of the stroke: 0.9566 v0.

    The integral of sqrt(1 - u^2) from -1/2 to 1/2 = sqrt(3)/4 + arcsin(1/2) = 0.43301 + 0.52360.
    """
    found = of_a_sine(1e5, 80.0, 200.0, 1 / dep)
    assert found["energy"] * 1000 / (4 * 95 * 80) == pytest.approx(factor, abs=1e-3)
    assert found["plateau"] == pytest.approx(80 * (1 + 9.5661 / dep), rel=1e-3)
    assert found["most"] == pytest.approx(80 * max(1.0, 1 + 10 / dep), rel=1e-2)  # samples end short of standstill


def test_effective_stiffness_and_damping():
    """Rigid: 2/pi. Elastic to 80/18 mm: E = 4 F (A - F/K), k = F/A, damping (2/pi)(1 - F/(K A)); nothing is lost."""
    assert of_a_sine(1e5, 80.0, 500.0, 0.0)["damping"] == pytest.approx(0.63662, abs=1e-3)
    elastic = of_a_sine(18.0, 80.0, 500.0, 0.0)
    assert elastic["energy"] * 1000 == pytest.approx(4 * 80 * (95 - 80 / 18), rel=2e-3)
    assert elastic["damping"] == pytest.approx(2 / np.pi * (1 - 80 / (18 * 95)), rel=2e-3)
    assert elastic["stiffness"] == pytest.approx(80 / 95, rel=1e-3)
    for name in ("least", "plateau", "first", "third", "last", "push", "pull", "most"):
        assert elastic[name] == pytest.approx(80.0, rel=2e-3)
    assert elastic["loss_per_m"] == pytest.approx(0.0, abs=1e-6)


def test_exponents_of_other_programs():
    """Wen with exponent 2 is a hyperbolic tangent; Steel02 meets the knee of Eq. (1)."""
    beta = -math.log(2.0) / math.log(math.tanh(1.0))
    assert wen_exponent(beta) == pytest.approx(2.0, abs=1e-6)
    assert wen_exponent(300.0) == 20.0
    r = exponent_of_steel02(10.0)
    assert -1 + 2 * 2 ** (-1 / r) == pytest.approx(2 ** (-1 / 10))
    assert exponent_of_steel02(400.0) == SHARPEST
