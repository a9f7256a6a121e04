"""The search for the most probable parameters."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, stats

from shj_bayes.errors import InferenceError
from shj_bayes.inference.binning import Run
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.start import Start, find_start, law_starts, most_probable_noise, root_of
from shj_bayes.model.filter import sd_over_speed, slowness
from shj_bayes.model.simulate import Truth

Make = Callable[..., Likelihood]
Vector = Callable[..., np.ndarray]
NOISE = {"sigma_slow": 0.4, "tau_slow": 1.0, "phi": 0.0, "displacement_noise_mm": 0.0}
DEVICES = {
    "sharp, slower when fast": Truth(K=15.0, Fy=90.0, beta=60.0, gamma=-1 / 30, ratio=0.87, sigma=0.5, **NOISE),
    "round, faster when fast": Truth(K=8.0, Fy=50.0, beta=3.0, gamma=1 / 60, ratio=0.4, sigma=1.0, **NOISE),
    "weak": Truth(K=18.0, Fy=22.0, beta=10.0, gamma=0.0, ratio=0.5, sigma=0.2, **NOISE),
}


@pytest.fixture(scope="module")
def found(make_small: Make) -> tuple[Likelihood, Start]:
    """The small device in its blocks, and its top."""
    return find_start(make_small())


@pytest.mark.parametrize("variant", ["published", "continuous"])
@pytest.mark.parametrize("name", DEVICES)
def test_map_is_near_the_truth(make_small: Make, as_vector: Vector, name: str, variant: str) -> None:
    posterior, start = find_start(make_small(DEVICES[name], variant=variant))
    truth = posterior.model.laws.unbounded(as_vector(posterior, DEVICES[name]))[0]
    # In units of its own curvature the truth is a chi-squared draw; 1e-4 of those are larger than this.
    distance = (start.free - truth) @ np.linalg.solve(start.covariance, start.free - truth)
    assert distance < stats.chi2(truth.size).ppf(1 - 1e-4) * 1.5  # the Gaussian is an approximation
    assert start.log_posterior >= posterior.log_posterior_free(truth[None])[0]


@pytest.mark.parametrize("ratio", [0.4, 1.0, 2.5])
def test_noise_at_low_speed_is_found(make_small: Make, ratio: float) -> None:
    """Over 20 seeds the error has a mean of up to 0.05 and a standard deviation of 0.08: 1 in 10 000 is beyond 0.35."""
    small = make_small(replace(DEVICES["weak"], sigma_slow=0.0), rate_Hz=12.0)
    rng, runs = np.random.default_rng(5), []
    for run, history in zip(small.runs, small.histories, strict=True):
        sd = sd_over_speed(np.log(ratio), slowness(history.speed_mm_s, history.peak_speed_mm_s))
        more = 2.0 * sd * rng.standard_normal(sd.size)
        force = run.recording.force_kN + more
        runs.append(Run(replace(run.recording, force_kN=force), run.motion))
    found, start = find_start(make_likelihood(runs, small.model))
    assert found.at_rest == pytest.approx(np.log(ratio), abs=0.35)
    moved = found.with_noise_at_rest(found.at_rest + 0.4).log_posterior_free(start.free[None])[0]
    assert moved < start.log_posterior


def test_the_noise_is_found_along_a_narrow_bent_valley() -> None:
    """With slopes by forward differences, which are off by half a step's curvature, a search ends far from its end."""

    def negative(u: np.ndarray) -> float:
        return float(3000.0 * (u[1] - u[0] ** 2 / 8.0) ** 2 + 1.25 * (u[0] - 4.0) ** 2)

    first = np.array([-4.0, 2.3])
    along = optimize.minimize(negative, first, method="BFGS", options={"maxiter": 60, "gtol": 0.3, "eps": 1e-3})
    assert along.fun > 1.0
    assert negative(most_probable_noise(negative, [first], 8.0)) < 0.1
    assert np.abs(most_probable_noise(negative, [first], 3.0)).max() == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize("noise", ["ar1", "independent", "student"])
def test_other_noises_find_the_same_law(make_small: Make, found: tuple[Likelihood, Start], noise: str) -> None:
    posterior, start = find_start(make_small(noise=noise))
    n = posterior.model.n_law
    sd = np.sqrt(np.diag(found[1].covariance))[:n]
    assert np.all(np.abs(start.free[:n] - found[1].free[:n]) < 1.5 * sd)


def test_map_is_a_maximum_with_the_right_curvature(found: tuple[Likelihood, Start]) -> None:
    posterior, start = found
    sd = np.sqrt(np.diag(start.covariance))
    around = start.free + np.vstack([np.diag(0.3 * sd), -np.diag(0.3 * sd)])
    assert np.all(posterior.log_posterior_free(around) < start.log_posterior)
    assert np.all(np.linalg.eigvalsh(start.covariance) > 0)
    # Along each eigenvector, one standard deviation away, the density has fallen by about 1/2.
    values, vectors = np.linalg.eigh(start.covariance)
    both = [start.free + s * np.sqrt(values)[:, None] * vectors.T for s in (1, -1)]
    fall = start.log_posterior - 0.5 * sum(posterior.log_posterior_free(z) for z in both)
    assert np.all(fall > 0.3)
    assert np.all(fall < 0.9)


def test_effects_are_found_one_after_another(make_small: Make) -> None:
    """Slack and asymmetry added to a device: the search finds both, whose sizes it was not told."""
    plain = make_small(effects=("slack", "asymmetry"))
    model = plain.model
    truth = plain.model.laws.natural(np.zeros((1, len(model.names))))
    values = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 0.0, "ratio": 0.8, "asymmetry.size": 0.06}
    for name, value in (values | {"slack.size": 2.0, "slack.softness": 0.1, "slack.start": 0.5}).items():
        truth[0, model.names.index(name)] = value
    runs = []
    for number, (run, history) in enumerate(zip(plain.runs, plain.histories, strict=True), start=1):
        noise = np.random.default_rng(number).normal(0, 0.5, run.recording.n_samples)
        force = plain.model.force(truth, history, run.start_force_kN)[0] + noise
        runs.append(Run(replace(run.recording, force_kN=force), run.motion))
    bare = model.with_effects(())
    assert len(law_starts(make_likelihood(runs, bare))) > 1
    posterior, start = find_start(make_likelihood(runs, model))
    theta = dict(zip(posterior.model.names, posterior.model.laws.natural(start.free[None])[0], strict=True))
    assert theta["slack.size"] == pytest.approx(2.0, abs=0.1)
    assert theta["asymmetry.size"] == pytest.approx(0.06, abs=0.01)
    assert start.log_posterior > find_start(make_likelihood(runs, bare))[1].log_posterior + 100


def test_a_point_that_is_known_is_climbed_from(make_small: Make, found: tuple[Likelihood, Start]) -> None:
    """A top from another search joins the candidates; a bad one does not spoil what is found."""
    small = make_small()
    n = small.model.n_law
    for top in (found[1].free[:n], np.full(n, 2.0)):
        _, start = find_start(small, tops=[top])
        assert start.log_posterior == pytest.approx(found[1].log_posterior, abs=0.01)


def test_search_is_repeatable(make_small: Make) -> None:
    a, b = (find_start(make_small())[1] for _ in range(2))
    assert np.array_equal(a.free, b.free)
    assert np.array_equal(a.covariance, b.covariance)


def test_nothing_to_fit(make_small: Make) -> None:
    small = make_small(n_runs=1)
    run = small.runs[0]
    still = Run(run.recording, replace(run.motion, speed_mm_s=np.zeros(run.recording.n_samples)))
    with pytest.raises(InferenceError, match=r"nothing to fit: largest force .* kN, stroke 48 mm, speed 0 mm/s"):
        find_start(make_likelihood([still], small.model))


def test_a_covariance_that_rounding_left_without_a_root_still_has_one():
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    for least in (1e-3, -1e-9):
        covariance = axes @ np.diag([least, 0.1, 1.0, 2.0, 30.0]) @ axes.T
        if least < 0.0:
            with pytest.raises(np.linalg.LinAlgError):
                np.linalg.cholesky(covariance + 1e-14 * np.eye(5))
        root = root_of(covariance)
        np.testing.assert_allclose(root @ root.T, covariance, atol=1e-8)
