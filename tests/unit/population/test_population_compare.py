"""Contrasts over sets and kinds of sets, classical tests, power, correlation within a device."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import PopulationError
from shj_bayes.population.compare import (
    MOST,
    Direction,
    assurance,
    classical,
    compare,
    devices_needed,
    holm,
    permutation_test,
    row_of,
    strata_of,
    welch,
)
from shj_bayes.population.device import Tags, published_rows
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import correlation_draws, inverse_wishart, new_device, scatter
from shj_bayes.report.sets import contrast_words, multiplicity_words
from shj_validation.paper_claims import coated_table


def known_population(levels, spreads, tags, points, seed=5, n=4000):
    """A population whose posterior is made, not fitted: Fy only."""
    rng = np.random.default_rng(1)
    mu = np.log(levels) + 0.02 * rng.standard_normal((n, len(levels)))
    tau = np.tile(np.array(spreads, dtype=float), (n, 1))
    hyper = np.tile([4.0, 0.3, 0.1, 0.5], (n, 1))
    fit = QuantityPosterior("Fy", mu, tau, hyper, tuple(len(p) for p in points))
    sets = tuple(
        DeviceSet(f"s{i}", tuple(str(k) for k in range(len(p))), t, {"Fy": tuple(np.log(p))})
        for i, (t, p) in enumerate(zip(tags, points, strict=True))
    )
    return PopulationResult(sets, {"Fy": fit}, {"alike": {"Fy": fit}}, {}, {}, seed)


def said(result, a, b, **options):
    found = compare(result, a, b, **options)
    return contrast_words(found[0], *strata_of(result, a, b)[:2])


BARE, ZINC = Tags(material="b"), Tags("zinc", 70.0, material="b")
FULL = replace(ZINC, coverage_percent=100.0)
TAGS = (ZINC, replace(ZINC, corroded=True), FULL, replace(FULL, corroded=True), BARE)
POINTS = ((80.0, 90.0), (60.0, 65.0), (70.0, 72.0, 75.0), (50.0, 58.0), (100.0,))
LEVELS = (85.0, 62.0, 72.0, 54.0, 100.0)


@pytest.fixture(scope="module")
def made():
    return known_population(LEVELS, (0.1, 0.1, 0.1, 0.1, 0.1), TAGS, POINTS)


def test_kinds_are_compared_pair_by_pair(made):
    found = compare(made, "corroded", "uncorroded")
    force = found[0]
    assert len(force.pairs) == 2
    assert force.q50 == pytest.approx(math.sqrt(62 / 85 * 54 / 72), rel=0.01)
    assert force.difference[1] == pytest.approx(((62 - 85) + (54 - 72)) / 2, rel=0.03)
    assert force.difference_unit == "kN"
    assert (force.n_a, force.n_b) == (4, 5)
    assert force.probability_level < 1e-3
    assert force.probability_rope < 1e-3
    assert len(compare(made, "70 %", "coverage 100")[0].pairs) == 2
    coated = compare(made, "coated", "uncoated")
    assert len(coated[0].pairs) == 1
    assert coated[0].n_a == 5  # the two uncorroded coatings; there is no corroded bare set


def test_what_cannot_be_compared_is_said(made):
    with pytest.raises(PopulationError, match="two kinds of sets"):
        compare(made, "corroded", "s0")
    with pytest.raises(PopulationError, match="with itself"):
        compare(made, "s0", "s0")
    with pytest.raises(PopulationError, match="no two sets differ"):
        compare(made, "corroded", "corroded")
    with pytest.raises(PopulationError, match="no two sets differ"):
        compare(made, "70 %", "50 %")
    with pytest.raises(PopulationError, match="between 0 and 1"):
        compare(made, "s0", "s1", rope=10.0)


def test_superiority_and_practical_equivalence_have_closed_forms(made):
    force = compare(made, "s0", "s1")[0]
    wanted = stats.norm.cdf(math.log(85 / 62) / math.hypot(0.1, 0.1, 0.02 * math.sqrt(2)))
    assert force.superiority == pytest.approx(wanted, abs=0.003)
    same = compare(known_population((80.0, 80.0), (0.1, 0.1), (BARE, ZINC), ((80.0,), (80.0,))), "s0", "s1")
    inside = stats.norm.cdf(math.log(1.1) / (0.02 * math.sqrt(2)))
    assert same[0].probability_rope == pytest.approx(2 * inside - 1, abs=0.003)
    assert "differ by less than 10 %" in contrast_words(same[0], "s0", "s1")


def test_a_small_sample_is_told_what_would_decide():
    open_ = known_population((80.0, 79.0), (0.3, 0.3), (BARE, ZINC), ((70.0, 90.0), (66.0, 95.0)))
    wide = replace(open_.posteriors["Fy"], mu=np.log(80.0) + 0.2 * np.random.default_rng(2).standard_normal((4000, 2)))
    open_ = replace(open_, posteriors={"Fy": wide})
    sentence = said(open_, "s0", "s1")
    assert "no effect" not in sentence
    assert "not settled" in sentence
    assert f"finds a true difference of 10 %, the smallest that matters here, with a power of {0.053:.2f}" in sentence
    assert assurance(math.log(1.1), 0.3, 2, 2) == pytest.approx(0.053, abs=0.003)
    assert "devices a side (if sets spread nearly alike)" in sentence


def test_a_narrow_interval_is_given_with_the_digits_that_tell_its_ends_apart():
    """Not a factor of anything from 1.00 to 1.00."""
    points = ((80.0, 80.01, 80.02), (80.01, 80.02, 80.0))
    narrow = known_population((80.0, 80.0), (1e-4, 1e-4), (BARE, ZINC), points)
    fit = narrow.posteriors["Fy"]
    level = np.log(80.0)
    fits = {"Fy": replace(fit, mu=level + 0.02 * (fit.mu - level))}
    narrow = replace(narrow, posteriors=fits, other_priors={"alike": fits})
    assert "a factor of anything from 0.999 to 1.001" in said(narrow, "s0", "s1")


def test_table_holds_every_test(made):
    row = row_of(compare(made, "s0", "s1")[0])
    wanted = {"welch_p", "permutation_p", "arrangements", "holm_p", "power_edge"}
    wanted |= {"permutation_least", "holm_test"}
    assert wanted | {"n_to_decide", "probability_rope", "difference_q50", "spread_factor_q50"} <= set(row)
    assert "1 parameters were compared" in multiplicity_words((), compare(made, "s0", "s1"), 1)


def test_welch_against_scipy(rng):
    a, b = rng.normal(0, 1, 5), rng.normal(0.5, 2, 7)
    assert welch([(a, b)]) == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue)
    assert welch([(a[:1], b)]) is None


def test_permutation_is_exact_and_agrees_with_the_paper():
    force = np.log(coated_table(lambda row: row.values["Fy", 1], published_rows()))
    p, least, n = permutation_test([(row[1], row[0]) for row in force])
    assert n == 7776
    assert least >= 2 / 7776
    assert p == pytest.approx(0.062, abs=0.001)
    a, b = np.array([1.0, 2.0, 9.0]), np.array([3.0, 4.0])
    wanted = stats.permutation_test((a, b), lambda x, y: abs(np.mean(x) - np.mean(y)), alternative="greater").pvalue
    assert permutation_test([(a, b)])[0] == pytest.approx(wanted)


def test_permutation_of_many_devices_is_drawn(rng):
    a, b = rng.normal(0, 1, 40), rng.normal(0.6, 1, 40)
    p, least, n = permutation_test([(a, b)], seed=1)
    assert n > 1e6
    assert least == 1 / 20_000
    assert p == permutation_test([(a, b)], seed=1)[0]
    assert p == pytest.approx(stats.ttest_ind(a, b).pvalue, abs=0.01)


def test_nothing_is_tested_where_a_side_is_empty():
    nothing = classical([(np.empty(0), np.array([1.0, 2.0]))])
    assert (nothing.welch_p, nothing.permutation_p, nothing.arrangements) == (None, None, 0)


def test_holm():
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_power_of_two_devices():
    """A factor of 2 at a spread of 0.34, by another simulation of 60 to 400 campaigns: 0.24, 0.70, 0.92."""
    found = [assurance(math.log(2.0), 0.34, n, n) for n in (2, 4, 6)]
    assert found == pytest.approx([0.24, 0.70, 0.92], abs=0.04)
    assert assurance(0.0, 0.3, 5, 5) == pytest.approx(0.05, abs=1e-6)
    assert assurance(50.0, 0.1, 9, 9) == pytest.approx(1.0)
    assert assurance(1.0, 0.3, 1, 1) == 0.0
    for n_a, n_b, shift in ((2, 2, 0.3), (3, 3, 0.6), (3, 7, 0.3)):  # the noncentral t, where scipy can give it
        limit, away = stats.t.isf(0.025, n_a + n_b - 2), shift / (0.3 * math.sqrt(1 / n_a + 1 / n_b))
        wanted = stats.nct.sf(limit, n_a + n_b - 2, away) + stats.nct.cdf(-limit, n_a + n_b - 2, away)
        assert assurance(shift, 0.3, n_a, n_b) == pytest.approx(wanted, abs=1e-5)
    n = devices_needed(math.log(2.0), 0.34)
    assert assurance(math.log(2.0), 0.34, n, n) >= 0.8 > assurance(math.log(2.0), 0.34, n - 1, n - 1)
    assert devices_needed(1e-6, 1.0) == MOST
    with pytest.raises(PopulationError, match="above zero"):
        assurance(1.0, 0.0, 3, 3)


def correlated_population(rho, n_sets=40, seed=8):
    rng = np.random.default_rng(seed)
    cover = 0.2**2 * np.array([[1.0, rho], [rho, 1.0]])
    points = [rng.multivariate_normal([4.4, -0.3], cover, 3) for _ in range(n_sets)]
    n = 400
    sets = tuple(
        DeviceSet(f"s{i}", ("a", "b", "c"), Tags(), {"Fy": tuple(p[:, 0]), "ratio": tuple(p[:, 1])})
        for i, p in enumerate(points)
    )

    def fit(name, level):
        mu, tau = np.full((n, n_sets), level), np.full((n, n_sets), 0.2)
        hyper = np.tile([level, 0.1, 0.2, 0.1], (n, 1))
        return QuantityPosterior(name, mu, tau, hyper, (3,) * n_sets)

    return PopulationResult(sets, {"Fy": fit("Fy", 4.4), "ratio": fit("ratio", -0.3)}, {}, {}, {}, 3)


@pytest.mark.parametrize("rho", [-0.7, 0.0, 0.7])
def test_correlation_is_found_and_reaches_the_second_run(rho):
    result = correlated_population(rho)
    names, _, degrees = scatter(result)
    assert (names, degrees) == (("Fy", "ratio"), 80)
    draws = correlation_draws(result, 2000)
    assert draws[:, 0, 1].mean() == pytest.approx(rho, abs=0.2)
    device = new_device(replace(result), "s0")
    assert np.std(np.log(device.draws["Fy"])) == pytest.approx(0.2, rel=0.12)
    wanted = 0.2 * math.sqrt(2 + 2 * draws[:, 0, 1].mean())
    assert np.std(np.log(device.draws["Fy_second"])) == pytest.approx(wanted, rel=0.15)


def test_without_replicates_correlation_is_uniform():
    result = correlated_population(0.5, n_sets=1)
    alone = replace(
        result,
        sets=tuple(replace(s, points={q: v[:1] for q, v in s.points.items()}, devices=("a",)) for s in result.sets),
    )
    assert scatter(alone)[2] == 0
    rho = correlation_draws(alone, 4000)[:, 0, 1]
    assert stats.kstest(rho, stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_three_against_three_cannot_go_below_a_tenth():
    """C(6, 3) = 20 arrangements; the two that part the sides fully are the farthest: 2/20 = 0.10, times 5 is 0.50."""
    far = classical([(np.log([90.0, 91.0, 92.0]), np.log([60.0, 61.0, 62.0]))])
    assert (far.permutation_p, far.permutation_least, far.arrangements) == (0.10, 0.10, 20)
    assert far.leading(5) == ("Welch", far.welch_p)
    five = classical([(np.arange(5.0), 10.0 + np.arange(5.0))])
    assert five.permutation_least == pytest.approx(2 / 252)
    assert five.leading(5)[0] == "permutation"  # 5 x 0.0079 = 0.040
    assert five.leading(7)[0] == "Welch"  # 7 x 0.0079 = 0.056
    assert classical([(np.array([1.0]), np.array([2.0, 2.1]))]).leading(1) == ("", None)
    # Values that repeat raise the least p: three equal ones of four leave one arrangement in two as far out.
    assert classical([(np.array([1.0, 1.0]), np.array([1.0, 2.0]))]).permutation_least == 1.0


def test_a_difference_beyond_doubt_is_not_hidden_by_the_adjustment():
    points = ((90.0, 91.0, 92.0), (60.0, 61.0, 62.0))
    force = compare(known_population((91.0, 61.0), (0.02, 0.02), (BARE, ZINC), points), "s0", "s1")[0]
    assert force.direction is Direction.SETTLED
    assert "whatever is assumed of the spread (Welch's test" in contrast_words(force, "s0", "s1")
    assert force.tests.permutation_p == 0.10
    assert force.holm_test == "Welch"
    assert force.holm_p == pytest.approx(stats.ttest_ind(*np.log(points), equal_var=False).pvalue)
    assert force.holm_p < 1e-4


def test_the_adjusted_test_keeps_its_level_where_nothing_differs():
    """Three against three in five quantities, nothing different: any Holm value below 0.05 in at most 5 % of cases."""
    rng = np.random.default_rng(77)
    n, alarms = 1500, 0
    for values in rng.standard_normal((n, 5, 2, 3)):
        tests = [classical([(a, b)]) for a, b in values]
        p = holm([t.leading(5)[1] for t in tests])
        alarms += min(x for x in p if x is not None) < 0.05
    assert alarms / n < 0.05 + 3 * math.sqrt(0.05 * 0.95 / n)


def test_devices_needed_come_from_the_edge_and_not_from_what_was_seen():
    """n = 2 (1.960 + 0.842)^2 (0.10 / ln 1.1)^2 = 2 x 7.851 x 1.1008 = 17.3; the t distribution adds about one."""
    assert devices_needed(math.log(1.1), 0.10) in (18, 19)
    near, far = (
        compare(known_population((80.0, b), (0.1, 0.1), (BARE, ZINC), ((80.0, 81.0), (b, b + 1))), "s0", "s1")
        for b in (79.0, 40.0)
    )
    assert near[0].n_to_decide == far[0].n_to_decide
    assert near[0].power_edge == far[0].power_edge


def test_assurance_averages_over_the_spread_and_is_never_nan():
    """Halfway between two spreads' powers, not the power at their middle."""
    two = [assurance(0.2, sd, 5, 5) for sd in (0.1, 0.4)]
    assert assurance(0.2, np.array([0.1, 0.4]), 5, 5) == pytest.approx(sum(two) / 2)
    for shift in (0.0, 0.01, 1.0, 300.0):
        for n in (2, 3, 30, 5000):
            found = assurance(shift, np.geomspace(1e-9, 1e3, 50), n, n)
            assert 0.0 <= found <= 1.0 + 1e-9


def test_draws_of_the_inverse_wishart_law_have_its_means():
    """E X = S / (v - k - 1) and E X^-1 = v S^-1; five Monte-Carlo errors, so 12 comparisons fail by chance in 1e-5."""
    scale, degrees = np.array([[2.0, 0.3, -0.5], [0.3, 1.0, 0.2], [-0.5, 0.2, 0.7]]), 14.5
    drawn = inverse_wishart(degrees, scale, 40_000, np.random.default_rng(3))
    for values, mean in ((drawn, scale / (degrees - 4)), (np.linalg.inv(drawn), degrees * np.linalg.inv(scale))):
        error = values.std(axis=0) / np.sqrt(len(values))
        assert np.all(np.abs(values.mean(axis=0) - mean) < 5 * error)


def test_one_device_never_settles_a_direction_whatever_is_assumed_of_the_spread():
    """Every prior gives it, far apart as they lie; but a set of one says nothing of its own spread."""
    one = known_population((40.0, 80.0), (0.02, 0.02), (BARE, ZINC), ((40.0,), (80.0, 81.0)))
    assert compare(one, "s0", "s1")[0].direction is Direction.TRIED
    assert "these devices alone do not (a set of one device tells nothing" in said(one, "s0", "s1")
    many = known_population((40.0, 80.0), (0.02, 0.02), (BARE, ZINC), ((40.0,), tuple(80.0 + np.arange(30.0) / 9)))
    assert compare(many, "s0", "s1")[0].direction is Direction.TRIED  # 2 of 31 arrangements are as far out
    scattered = known_population((60.0, 80.0), (0.02, 0.02), (BARE, ZINC), ((40.0, 90.0), (60.0, 107.0)))
    assert compare(scattered, "s0", "s1")[0].direction is Direction.TRIED
    assert "these devices alone do not (Welch's test gives p = 0.6" in said(scattered, "s0", "s1")


def test_where_test_and_posterior_disagree_it_says_why():
    """`compare tables "70 %" "100 %"`, ratio: "not settled, 0.97 to 1.30" beside p of 0.009, observed 1.50."""
    points = ((90.0, 91.0, 92.0, 93.0), (60.0, 61.0, 62.0, 63.0))
    drawn = known_population((80.0, 79.0), (0.3, 0.3), (BARE, ZINC), points)
    words = said(drawn, "s0", "s1")
    assert "Yet the exact permutation finds a difference (p = 0.029, 0.029 after Holm)" in words
    assert "of the observed 1.49 that leaves 1.01" in words
    assert "Yet" not in said(
        known_population((80.0, 79.0), (0.3, 0.3), (BARE, ZINC), ((80.0, 70.0), (79.0, 72.0))), "s0", "s1"
    )


def test_opposite_pairs_are_named(made):
    found = compare(made, "corroded", "uncorroded")[0]
    assert [p.observed for p in found.pairs] == pytest.approx(
        [(60 * 65 / (80 * 90)) ** 0.5, (50 * 58) ** 0.5 / (70 * 72 * 75) ** (1 / 3)]
    )
    assert found.observed == pytest.approx((found.pairs[0].observed * found.pairs[1].observed) ** 0.5)
    assert "Pair by pair 0.74 to 0.74 was observed" in contrast_words(found, "a", "b")
    turned = ((60.0, 65.0), (80.0, 90.0), (70.0, 72.0, 75.0), (30.0, 38.0), (100.0,))
    opposite = known_population(LEVELS, (0.1, 0.1, 0.1, 0.1, 0.1), TAGS, turned)
    assert "2 pairs do not agree in direction; against the mean of all: s1 over s0 1.36." in said(
        opposite, "corroded", "uncorroded"
    )
