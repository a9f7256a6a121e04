"""The grid against answers found without it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from shj_bayes.errors import PopulationError
from shj_bayes.population import hierarchy as grid
from shj_bayes.population.device import DeviceEstimate, published_devices, sets_of
from shj_bayes.population.hierarchy import cells_of, fit_population, fit_quantity, integrate
from shj_bayes.population.quantities import (
    QuantityLikelihood,
    of_draws,
    other_priors,
    population_prior,
    quantity,
    rounded,
    to_step,
)

FY = quantity("Fy")
PRIOR = population_prior("Fy")


def summary(x):
    return np.array([x.mean(), x.std(), *np.quantile(x, [0.05, 0.5, 0.95])])


def weighted_summary(x, weight):
    weight = weight / weight.sum()
    mean = np.sum(weight * x)
    order = np.argsort(x)
    cumulative = np.cumsum(weight[order])
    quantiles = [x[order][np.searchsorted(cumulative, p)] for p in (0.05, 0.5, 0.95)]
    return np.array([mean, np.sqrt(np.sum(weight * (x - mean) ** 2)), *quantiles])


@pytest.mark.parametrize("prior", [PRIOR, *other_priors(PRIOR).values()], ids=["default", "alike", "free"])
def test_one_set_of_two_rounded_values_against_a_grid(prior):
    """Brute force: the hyperparameters integrated by quadrature, then level and log spread on a fine grid."""
    intervals = [np.log([72.5, 77.5]), np.log([92.5, 97.5])]
    level, log_tau = np.meshgrid(np.linspace(2.5, 6.5, 801), np.linspace(-5, 3.5, 341), indexing="ij")
    tau = np.exp(log_tau)
    likelihood = np.ones_like(level)
    for low, high in intervals:
        likelihood *= stats.norm.cdf((high - level) / tau) - stats.norm.cdf((low - level) / tau)
    between = np.linspace(1e-4, 40, 2001)
    weight = stats.t.pdf(between / prior.between_scale, 4)
    x = level[:, 0]
    p_level = np.array(
        [np.sum(weight * stats.norm.pdf(v, prior.centre, np.hypot(prior.centre_sd, between))) for v in x]
    )
    omega = prior.unequal_scale * np.linspace(1e-3, 5, 100)
    p_omega = stats.norm.pdf(omega / prior.unequal_scale)
    t = np.linspace(-9, 9, 361)  # log tau0 about its median
    p_t = stats.norm.pdf(t / prior.spread_log_sd) if prior.spread_log_sd else np.exp(t) / (1 + np.exp(2 * t))
    centre = np.log(prior.spread_median)
    p_spread = np.array(
        [
            np.sum(p_omega[:, None] * p_t * stats.norm.pdf(v - centre - t, 0, np.hypot(omega[:, None], 0.05)))
            for v in log_tau[0]
        ]
    )
    posterior = likelihood * p_level[:, None] * p_spread
    fit = fit_quantity(
        "Fy",
        [[rounded("Fy", to_step(v, 5.0)) for v in (75.0, 95.0)]],
        prior,
        np.random.SeedSequence(5),
    )
    kept = posterior.sum(axis=0)
    sd = weighted_summary(log_tau[0], kept)[1]
    inside = (fit.tau[:, 0] > np.exp(-5)) & (fit.tau[:, 0] < np.exp(3.5))
    assert inside.mean() > 0.97
    found, wanted = summary(np.log(fit.tau[inside, 0])), weighted_summary(log_tau[0], kept)
    assert np.abs(found - wanted).max() < 0.15 * sd
    wanted = weighted_summary(x, posterior.sum(axis=1))
    central = np.abs(fit.mu[inside, 0] - 4.5) < 2.0
    assert np.abs(summary(fit.mu[inside, 0][central]) - wanted)[2:].max() < 0.1 * wanted[1]


LONG_CHAINS = np.array([
    [4.057, 4.249, 4.457], [3.731, 3.945, 4.598], [4.057, 4.249, 4.452], [4.000, 4.179, 4.425], [4.112, 4.376, 4.550],
    [4.441, 4.550, 4.608], [4.406, 4.496, 4.556], [3.632, 4.171, 4.785], [4.403, 4.496, 4.558], [3.529, 4.237, 4.968],
    [3.990, 4.139, 4.338], [3.937, 4.015, 4.141], [2.659, 4.169, 5.794], [4.203, 4.276, 4.348], [4.242, 4.316, 4.385],
])  # fmt: skip
"""5, 50 and 95 % of log Fy of a new device of each published set: four chains of 160 000 sweeps of slice sampling."""


def new_devices(sets, prior):
    """5, 50 and 95 % of a new device of each set, of all its cells, shape (sets, 3): no draws."""
    found, out = integrate(sets, prior), []
    for one in found.sets:
        cells = cells_of(found, one)
        at = one.level.centre + 0.01 * np.sinh(np.linspace(-7.5, 7.5, 241))
        below = np.zeros(at.size)
        for j, spread in enumerate(np.exp(one.spread.nodes)):
            below += ndtr((at[:, None] - one.level.nodes) / spread) @ cells[:, j]
        out.append(np.interp((0.05, 0.5, 0.95), below / below[-1], at))
    return np.array(out)


def test_published_sets_are_those_of_long_chains():
    sets = [[d.measurements["Fy"] for d in group] for group in sets_of(published_devices()).values()]
    found = new_devices(sets, PRIOR)
    spread = np.ptp(LONG_CHAINS, axis=1, keepdims=True)
    assert np.all(np.abs(found - LONG_CHAINS) < 0.02 * spread)


def devices_of(*values):
    return [QuantityLikelihood(False, np.array([v]), np.array([e]), np.ones(1)) for v, e in values]


STUDENT = 0.1 * np.random.default_rng(2).standard_t(2.5, 4000)
HARD = {
    "one device": [devices_of((4.4, 0.03))],
    "one of each": [devices_of((v, 0.02)) for v in (4.2, 4.5, 4.3, 4.9, 4.4)],
    "equal": [[rounded("Fy", to_step(90.0, 5.0))] * 2] * 6,
    "exact": [devices_of((4.1, 1e-6), (4.3, 1e-6)), devices_of((4.5, 1e-6), (4.6, 1e-6), (4.2, 1e-6))],
    "one known badly": [devices_of((4.4, 0.05), (4.5, 0.05), (3.5, 1.5)), devices_of((4.6, 2.0)), []],
    "heavy tails": [[of_draws("Fy", np.exp(m + k * STUDENT), np.zeros(4000)) for m, k in ((4.3, 1), (4.5, 3))]],
}


@pytest.mark.parametrize("case", HARD)
@pytest.mark.parametrize("prior", [PRIOR, *other_priors(PRIOR).values()], ids=["default", "alike", "free"])
def test_cells_are_small_enough(case, prior, monkeypatch):
    found = new_devices(HARD[case], prior)
    monkeypatch.setattr(grid, "FINE", (96, 72, (28, 28, 26, 20)))
    finer = new_devices(HARD[case], prior)
    assert np.all(np.abs(found - finer) < 0.02 * np.ptp(finer, axis=1, keepdims=True))


SPREAD, ERROR = 0.2, 0.1
CENTRES = np.array([[4.1, 4.35, 4.2], [4.7, 4.4, 4.6], [4.3, 4.5, 4.2], [3.9, 4.0, 4.3]])


def closed_form_levels():
    """Posterior means and sds of the set levels, spread known, S by quadrature, the rest exact."""
    n_sets, n = CENTRES.shape
    mean, variance = CENTRES.mean(axis=1), (SPREAD**2 + ERROR**2) / n
    weights, means, seconds = [], [], []
    for between in np.linspace(1e-3, 12, 12000):
        covariance = np.eye(n_sets) * (between**2 + variance) + PRIOR.centre_sd**2
        prior_covariance = np.eye(n_sets) * between**2 + PRIOR.centre_sd**2
        gain = prior_covariance @ np.linalg.inv(covariance)
        m = PRIOR.centre + gain @ (mean - PRIOR.centre)
        v = np.diag(prior_covariance - gain @ prior_covariance)
        _, log_det = np.linalg.slogdet(covariance)
        r = mean - PRIOR.centre
        log_evidence = -0.5 * (log_det + r @ np.linalg.solve(covariance, r))
        weights.append(stats.t.logpdf(between / PRIOR.between_scale, 4) + log_evidence)
        means.append(m)
        seconds.append(v + m**2)
    w = np.exp(np.array(weights) - max(weights))
    w /= w.sum()
    centre = w @ np.array(means)
    return centre, np.sqrt(w @ np.array(seconds) - centre**2)


@pytest.mark.parametrize("kind", ["exact normal", "importance draws"])
def test_gaussian_case_against_its_closed_form(kind, rng):
    known = replace(PRIOR, spread_median=SPREAD, spread_log_sd=1e-4, unequal_scale=1e-4)
    m0, s0 = 4.0, 0.5  # single-device prior
    precision = 1 / ERROR**2 + 1 / s0**2

    def device(centre):
        if kind == "exact normal":
            return QuantityLikelihood(False, np.array([centre]), np.array([ERROR]), np.ones(1))
        z = stats.norm.ppf((np.arange(4000) + 0.5) / 4000)
        draws = (centre / ERROR**2 + m0 / s0**2) / precision + precision**-0.5 * z
        return of_draws("Fy", np.exp(draws), stats.norm.logpdf(draws, m0, s0))

    fit = fit_quantity("Fy", [[device(c) for c in row] for row in CENTRES], known, np.random.SeedSequence(8))
    centre, sd = closed_form_levels()
    assert np.abs(fit.mu.mean(axis=0) - centre).max() < 0.1 * sd.min()
    assert fit.mu.std(axis=0) == pytest.approx(sd, rel=0.06)
    shrunk = np.abs(fit.mu.mean(axis=0) - CENTRES.mean()) < np.abs(CENTRES.mean(axis=1) - CENTRES.mean())
    assert shrunk.sum() >= 3


def test_identical_rounded_values_do_not_give_zero_spread():
    def spread(step, name="default"):
        prior = PRIOR if name == "default" else other_priors(PRIOR)[name]
        sets = [[rounded("Fy", to_step(90.0, step))] * 2 for _ in range(3)]
        return np.quantile(fit_quantity("Fy", sets, prior, np.random.SeedSequence(2)).tau[:, 0], 0.5)

    coarse, fine = spread(5.0), spread(0.05)
    assert coarse > 3 * fine
    assert coarse > 0.004  # not far below the rounding itself, sd 0.016
    assert spread(5.0, "alike") > 0.5 * coarse


def test_one_device_is_wider_than_eight(rng):
    def width(n):
        values = [rounded("Fy", to_step(v, 1.0)) for v in 80 * np.exp(0.1 * stats.norm.ppf((np.arange(n) + 0.5) / n))]
        fit = fit_quantity("Fy", [values], PRIOR, np.random.SeedSequence(2))
        new = np.random.default_rng(1).normal(fit.mu[:, 0], fit.tau[:, 0])
        return np.ptp(np.quantile(new, [0.05, 0.95]))

    assert width(1) > width(2) > width(8) > 2 * 1.645 * 0.09
    assert width(1) > 3 * width(8)


def new_device_coverage(n_devices, n_campaigns, *, ignore_spread=False, n_sets=5):
    held = []
    for c in range(n_campaigns):
        rng = np.random.default_rng([19, n_devices, c])
        mu, tau = rng.normal(np.log(80), 0.3, n_sets), 0.2 * np.exp(rng.normal(0, 0.5, n_sets))
        printed = 5.0 * np.maximum(np.round(np.exp(rng.normal(mu, tau, (n_devices, n_sets))) / 5.0), 1.0)
        sets = [[rounded("Fy", to_step(v, 5.0)) for v in printed[:, s]] for s in range(n_sets)]
        fit = fit_quantity("Fy", sets, PRIOR, np.random.SeedSequence([19, c]))
        new = fit.mu if ignore_spread else rng.normal(fit.mu, fit.tau)
        low, high = np.quantile(new, [0.05, 0.95], axis=0)
        held.append(np.mean(stats.norm.cdf((high - mu) / tau) - stats.norm.cdf((low - mu) / tau)))
    return np.mean(held), np.std(held, ddof=1) / np.sqrt(n_campaigns)


def covers_90_percent(coverage, error):
    """90 % up to 3 % of honest slack and three Monte-Carlo errors."""
    return abs(coverage - 0.9) < 0.03 + 3 * error


@pytest.mark.parametrize("n_devices", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_band_of_a_new_device_holds_90_percent(n_devices):
    assert covers_90_percent(*new_device_coverage(n_devices, 36))


def test_a_band_that_ignores_the_spread_fails_the_same_test():
    assert not covers_90_percent(*new_device_coverage(4, 12, ignore_spread=True))


def test_same_seed_same_numbers_whatever_the_other_quantities():
    def devices(*names):
        return [
            DeviceEstimate(f"{s}{v}", s, {q: rounded(q, to_step(v, 5.0)) for q in names})
            for s, v in (("a", 80), ("a", 90), ("b", 60))
        ]

    first = fit_population(devices("Fy"), seed=4).fit("Fy").mu
    assert np.array_equal(first, fit_population(devices("Fy"), seed=4).fit("Fy").mu)
    assert np.array_equal(first, fit_population(devices("K", "Fy"), seed=4).fit("Fy").mu)
    assert not np.array_equal(first, fit_population(devices("Fy"), seed=5).fit("Fy").mu)


def test_global_random_state_is_not_touched(result):
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    fit_population([DeviceEstimate("a", "s", {"Fy": rounded("Fy", (80, 75, 85))})], seed=1)
    assert np.array_equal(state, np.random.get_state()[1])  # noqa: NPY002


def test_far_apart_devices_are_still_pooled():
    sets = [[rounded("Fy", to_step(v, 0.001)) for v in (0.01, 80_000.0)]]
    fit = fit_quantity("Fy", sets, PRIOR, np.random.SeedSequence(1))
    assert np.all(np.isfinite(fit.mu))
    assert np.median(fit.tau) > 3


def test_a_negative_seed_and_an_empty_quantity_are_refused():
    with pytest.raises(PopulationError, match="seed must be zero"):
        fit_population([DeviceEstimate("a", "s", {"Fy": rounded("Fy", (80, 75, 85))})], seed=-1)
    with pytest.raises(PopulationError, match="nothing to pool"):
        fit_quantity("Fy", [[]], PRIOR, np.random.SeedSequence(1))
    with pytest.raises(PopulationError, match="every scale"):
        replace(PRIOR, spread_median=0.0)
