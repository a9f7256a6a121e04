from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from shj_bayes.errors import PopulationError
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import DeviceEstimate, Tags, device_from_fit, sets_of
from shj_bayes.population.hierarchy import log_likelihood
from shj_bayes.population.quantities import (
    Ordered,
    QuantityLikelihood,
    gamma_of_dep,
    of_draws,
    ratio_of,
    rounded,
    to_decade,
    to_step,
)
from shj_bayes.results.device import DeviceResult


def test_dep_of_30_stands_for_15_to_45():
    assert gamma_of_dep(30.0, 30.0)[1:] == pytest.approx((1 / 45, 1 / 15))
    assert gamma_of_dep(-30.0, 30.0)[1:] == pytest.approx((-1 / 15, -1 / 45))


def test_dep_that_reaches_zero_is_refused():
    with pytest.raises(PopulationError, match="no bound"):
        gamma_of_dep(10.0, 30.0)


def test_decade():
    assert to_decade(100.0)[1:] == pytest.approx((100 / 10**0.5, 100 * 10**0.5))


@pytest.mark.parametrize(("mu", "tau"), [(4.4, 0.2), (4.4, 1e-4), (3.0, 0.1), (6.0, 0.1), (4.36, 0.01)])
def test_rounded_value_is_integrated_exactly(mu, tau):
    likelihood = rounded("Fy", to_step(80.0, 5.0))
    low, high = np.log([77.5, 82.5])
    ends = [stats.norm.logsf(low, mu, tau), stats.norm.logsf(high, mu, tau)]
    if low <= mu:
        ends = [stats.norm.logcdf(high, mu, tau), stats.norm.logcdf(low, mu, tau)]
    exact = ends[0] + np.log1p(-np.exp(ends[1] - ends[0]))
    found = log_likelihood([likelihood], np.array([mu]), np.log([tau]))
    assert found.item() == pytest.approx(exact, rel=1e-6)


def test_ratio_of_rounded_values_has_the_right_density(rng):
    found = ratio_of(to_step(20.0, 5.0), to_step(50.0, 5.0)).centre_and_sd
    u = np.log(rng.uniform(17.5, 22.5, 400_000) / rng.uniform(47.5, 52.5, 400_000))
    assert found[0] == pytest.approx(u.mean(), abs=2e-3)
    assert found[1] == pytest.approx(u.std(), rel=0.05)


def test_draws_under_a_prior_give_back_the_likelihood(rng):
    centre, sd, m0, s0 = 4.5, 0.1, 4.0, 0.2
    precision = 1 / sd**2 + 1 / s0**2
    draws = rng.normal((centre / sd**2 + m0 / s0**2) / precision, precision**-0.5, 20_000)
    found = of_draws("Fy", np.exp(draws), stats.norm.logpdf(draws, m0, s0))
    assert found.centre_and_sd == pytest.approx((centre, sd), rel=0.05)  # unweighted: 4.4 and 0.089
    assert found.weight.sum() == pytest.approx(1.0)
    assert 1000 < found.effective_draws < 20_000


def test_skew_of_the_draws_survives(rng):
    draws = stats.loggamma.rvs(2.0, size=20_000, random_state=rng)
    found = of_draws("Fy", np.exp(draws), np.zeros(20_000))
    mean, sd = found.centre_and_sd
    assert (mean, sd) == pytest.approx((draws.mean(), draws.std()), rel=1e-6)

    def moment(x):
        return (x - mean) ** 3 * np.sum(found.weight * stats.norm.pdf(x, found.first, found.second))

    skew = integrate.quad(moment, mean - 12 * sd, mean + 12 * sd, limit=200)[0] / sd**3
    assert skew == pytest.approx(stats.skew(draws), rel=0.25)


def test_a_posterior_that_is_only_prior_is_refused(rng):
    draws = rng.normal(0.0, 1.0, 400)
    with pytest.raises(PopulationError, match="the prior, not the recording"):
        of_draws("Fy", np.exp(draws), -20.0 * draws)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: of_draws("Fy", np.ones((10, 2)), np.ones((10, 2))), "one column of at least 48"),
        (lambda: of_draws("Fy", np.ones(100), np.ones(99)), "one log density per draw"),
        (lambda: of_draws("Fy", np.ones(100), np.zeros(100)), "all posterior draws of Fy are equal"),
        (lambda: of_draws("Fy", np.ones(100), np.full(100, -np.inf)), "finite at every posterior draw"),
        (lambda: of_draws("Fy", -np.ones(100), np.zeros(100)), "finite and above zero"),
        (lambda: to_step(1.0, 0.0), "must be above zero"),
        (lambda: rounded("Fy", to_step(2.0, 5.0)), "finite and above zero"),
        (lambda: QuantityLikelihood(True, np.array([0.0, 2.0]), np.array([1.0, 3.0]), np.ones(2)), "adjoin"),
        (lambda: DeviceEstimate("a", "s", {}), "gives none of"),
        (lambda: DeviceEstimate(" ", "s", {"Fy": rounded("Fy", (80, 75, 85))}), "needs a name"),
        (lambda: DeviceEstimate("a", "s", {"dep": rounded("dep", (30, 15, 45))}), "dep is never pooled"),
        (lambda: sets_of([]), "no device given"),
    ],
)
def test_what_is_wrong_is_said(make, words):
    with pytest.raises(PopulationError, match=words):
        make()


def test_sets_refuse_double_names_and_mixed_tags():
    one = DeviceEstimate("a", "s", {"Fy": rounded("Fy", (80, 75, 85))})
    with pytest.raises(PopulationError, match="two devices of set 's' are called 'a'"):
        sets_of([one, one])
    other = DeviceEstimate("b", "s", {"Fy": rounded("Fy", (80, 75, 85))}, Tags(corroded=True))
    with pytest.raises(PopulationError, match="not its tags"):
        sets_of([one, other])


def test_a_posterior_that_is_refused_names_its_device(monkeypatch, tmp_path) -> None:
    found = SimpleNamespace(draws={"Fy": np.ones(100)}, laws={"Fy": read_priors().of("Fy")})
    monkeypatch.setattr(DeviceResult, "read", lambda _: found)
    with pytest.raises(PopulationError, match=r"device 'a': all posterior draws of Fy are equal"):
        device_from_fit(tmp_path, "a", "s")


@pytest.mark.parametrize("n", [1, 9, 64, 4001])
def test_quantiles_of_draws_in_order_are_those_of_numpy_to_the_bit(n):
    draws = np.random.default_rng(n).lognormal(size=n)
    parts = draws[: n // 10 * 10].reshape(10, -1)
    for level in (0.05, 0.5, 0.9332, 0.99, 1.0):
        error = np.std(np.quantile(parts, level, axis=1), ddof=1) / np.sqrt(10) if n > 9 else 0.0
        assert Ordered(draws).with_error(level) == (np.quantile(draws, level), error)
