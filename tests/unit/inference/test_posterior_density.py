"""The posterior density: what it is made of, where it ends, and that calls do not disturb one another."""

import dataclasses
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import InferenceError, PriorError
from shj_bayes.inference import likelihood as likelihood_module
from shj_bayes.inference.binning import Run, runs_of
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.start import find_start
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.filter import Timing
from shj_bayes.model.noise import noise_models
from shj_bayes.model.priors import MAX_SPREAD, Prior, read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.recording.recording import Recording

Make = Callable[..., Likelihood]


def points(posterior: Likelihood, m: int, seed: int = 1) -> np.ndarray:
    """Free vectors within the bulk of the prior."""
    return np.random.default_rng(seed).normal(0, 1, (m, len(posterior.model.names)))


def corners(posterior: Likelihood) -> np.ndarray:
    """All combinations of the far ends of the free space."""
    d = len(posterior.model.names)
    return np.asarray(29.999 * (2.0 * ((np.arange(2**d)[:, None] >> np.arange(d)) & 1) - 1.0))


def with_model(posterior: Likelihood, **changes: object) -> Likelihood:
    """The same runs under another model."""
    return make_likelihood(posterior.runs, dataclasses.replace(posterior.model, **changes))


def no_number(_noise: object, _values: object, residual: np.ndarray, _slope: object, timing: Timing) -> np.ndarray:
    """Density of a noise model that is broken."""
    return np.full((residual.shape[0], timing.half.size - 1), np.nan)


def test_likelihood_is_law_plus_noise(
    make_small: Make, truth: Truth, as_vector: Callable[..., np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks of one sample: all residuals under the covariance of white and slow noise and of the load cell's zero."""
    monkeypatch.setattr(Run, "start_noise_mm", 0.0)
    small = make_small(rate_Hz=3.0)
    assert all(np.all(part.count == 1) for part in small.blocks)
    theta = as_vector(small)
    expected = 0.0
    for number, (run, history) in enumerate(zip(small.runs, small.histories, strict=True), start=1):
        residual = run.recording.force_kN - small.model.force(theta, history, run.start_force_kN)[0]
        lag = np.abs(run.recording.time_s[:, None] - run.recording.time_s[None])
        covariance = truth.sigma_slow**2 * np.exp(-lag / truth.tau_slow) + truth.sigma**2 * np.eye(residual.size)
        covariance += small.blocks[number - 1].timing.zero_noise_kN ** 2
        expected += stats.multivariate_normal(np.zeros(residual.size), covariance).logpdf(residual)
    assert small.log_likelihood(theta)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("noise", noise_models())
def test_likelihood_knows_nothing_of_the_priors(make_small: Make, noise: str) -> None:
    """The same parameters reached through other priors and other free spaces have the same likelihood."""
    afc = make_small(noise=noise, effects=("asymmetry",))
    other_laws = {
        "K": Prior("K", "kN/mm", "uniform", 1.0, 60.0, "test"),
        "Fy": Prior("Fy", "kN", "loguniform", 1.0, 500.0, "test"),
        "beta": Prior("beta", "1", "uniform", 1.0, 500.0, "test"),
        "gamma": Prior("gamma", "s/mm", "uniform", -0.2, 0.2, "test"),
    }
    priors = afc.model.priors
    other = with_model(afc, priors=dataclasses.replace(priors, priors=priors.priors | other_laws))
    theta = afc.model.laws.natural(0.3 * points(afc, 6))
    back = other.model.laws.natural(other.model.laws.unbounded(theta))
    np.testing.assert_allclose(back, theta, rtol=1e-12)
    assert np.array_equal(afc.log_likelihood(theta), other.log_likelihood(theta))
    np.testing.assert_allclose(other.log_likelihood(back), afc.log_likelihood(theta), rtol=1e-9)
    own, further = afc.model.laws, other.model.laws
    assert not np.allclose(own.log_density(own.unbounded(theta)), further.log_density(further.unbounded(theta)))


@pytest.mark.parametrize("noise", noise_models())
def test_half_cycles_add_up(make_small: Make, noise: str) -> None:
    small = make_small(noise=noise)
    theta = small.model.laws.natural(points(small, 3))
    by_half_cycle = small.log_likelihood_by_half_cycle(theta)
    assert by_half_cycle.shape == (3, sum(run.motion.n_half for run in small.runs))
    np.testing.assert_allclose(by_half_cycle.sum(axis=1), small.log_likelihood(theta), rtol=1e-12)


def test_posterior_is_likelihood_and_prior(small_device: Likelihood) -> None:
    z = points(small_device, 5)
    expected = small_device.log_likelihood(small_device.model.laws.natural(z)) + small_device.model.laws.log_density(z)
    np.testing.assert_allclose(small_device.log_posterior_free(z), expected, rtol=1e-14)
    np.testing.assert_allclose(small_device.model.laws.unbounded(small_device.model.laws.natural(z)), z, atol=1e-9)


def test_points_outside_have_no_density(small_device: Likelihood) -> None:
    z = points(small_device, 6)
    inside = small_device.log_posterior_free(z)
    for row, value in enumerate((30.0, -30.0, 1e300, np.inf, -np.inf, np.nan)):
        z[row, row % z.shape[1]] = value
    assert np.all(small_device.log_posterior_free(z) == -np.inf)
    mixed = points(small_device, 6)
    mixed[[1, 4], 2] = 99.0
    got = small_device.log_posterior_free(mixed)
    assert np.all(got[[1, 4]] == -np.inf)
    np.testing.assert_allclose(got[[0, 2, 3, 5]], inside[[0, 2, 3, 5]], rtol=1e-13)


def test_every_corner_of_the_free_space_is_finite_or_nothing(small_device: Likelihood) -> None:
    """The sampler may step there, and an error would end the fit."""
    value = small_device.log_posterior_free(corners(small_device))
    assert not np.isnan(value).any()
    assert not np.any(value == np.inf)


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_the_widest_priors_stay_within_doubles(make_small: Make, variant: str) -> None:
    """Far corners of the widest laws that a file may hold: no density or a finite one, never an error."""
    priors = read_priors("general")
    wide = {n: dataclasses.replace(p, b=MAX_SPREAD) if p.law == "lognormal" else p for n, p in priors.priors.items()}
    small = make_small(priors=dataclasses.replace(priors, priors=wide), variant=variant)
    value = small.log_posterior_free(corners(small))
    assert not np.isnan(value).any()
    assert not np.any(value == np.inf)


def test_smaller_batches_do_not_see_the_larger_one_before(make_small: Make) -> None:
    small = make_small()
    z = points(small, 12)
    large = small.log_posterior_free(z)
    again = small.log_posterior_free(z[:5])
    assert np.array_equal(again, large[:5])
    assert np.array_equal(small.log_posterior_free(z), large)
    kept = small.model.force(small.model.laws.natural(z[:2]), small.histories[0], small.runs[0].start_force_kN)
    copy = kept.copy()
    small.log_posterior_free(z)
    assert np.array_equal(kept, copy)  # what a caller was given is not the reused memory


def test_threads_do_not_share_memory(make_small: Make) -> None:
    small = make_small()
    batches = [points(small, 3 + k % 9, seed=k) for k in range(60)]
    serial = [small.log_posterior_free(z) for z in batches]
    with ThreadPoolExecutor(4) as pool:
        parallel = list(pool.map(small.log_posterior_free, batches))
    assert all(np.array_equal(a, b) for a, b in zip(serial, parallel, strict=True))


def test_nan_is_reported_with_the_parameters(make_small: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    small = make_small()
    monkeypatch.setattr(likelihood_module, "log_density", no_number)
    with pytest.raises(
        InferenceError, match=r"not a number at K = .*, Fy = .*, beta = .*, tau_slow = .*; this is a bug"
    ):
        small.log_posterior_free(points(small, 2))
    with pytest.raises(InferenceError, match="K = "):
        find_start(small)


def test_unused_samples_and_gaps_reach_the_likelihood(make_small: Make, as_vector: Callable[..., np.ndarray]) -> None:
    small = make_small(n_runs=1)
    theta = as_vector(small)
    recording, motion = small.runs[0].recording, small.runs[0].motion
    used = np.ones(recording.n_samples, bool)
    used[50:60] = False
    spoilt = recording.force_kN.copy()
    spoilt[50:60] = 900.0

    def likelihood(force: np.ndarray, used: np.ndarray, time: np.ndarray) -> float:
        run = Run(Recording(time, recording.displacement_mm, force, used=used), motion)
        return float(make_likelihood([run], small.model).log_likelihood(theta)[0])

    time = recording.time_s
    assert likelihood(spoilt, used, time) == pytest.approx(likelihood(recording.force_kN, used, time), rel=1e-12)
    later = time + np.where(np.arange(time.size) >= 100, 10.0, 0.0)
    gap = likelihood(recording.force_kN, np.ones_like(used), later)
    whole = likelihood(recording.force_kN, np.ones_like(used), time)
    assert gap != pytest.approx(whole, abs=1e-6)  # the noise forgets itself across a gap


def test_start_force_of_a_loaded_device(make_small: Make) -> None:
    run = make_small(n_runs=1).runs[0]
    assert run.start_force_kN == 0.0
    x, n = run.recording.displacement_mm, run.recording.n_samples
    noise = np.random.default_rng(1).normal(0, 0.2, n)
    loaded = Run(Recording(run.recording.time_s, x, 55.0 + 10.0 * np.sign(x) + noise), run.motion)
    assert loaded.start_force_kN == pytest.approx(55.0, abs=12.0)


def test_a_recording_that_begins_in_motion_gives_the_numbers_of_the_whole_one() -> None:
    """The first 25 ms are missing, in which the device was moved by 0.25 mm and loaded to 5 % of its largest force."""
    truth = Truth(18.0, 80.0, 10.0, 1 / 60, 0.875, sigma=1.0, phi=0.0, displacement_noise_mm=0.02, sigma_slow=0.6)
    whole = simulate_device(truth, seed=1, rate_Hz=200.0)
    tops = []
    for first in (0, 5):
        cut = [Recording(r.time_s[first:], r.displacement_mm[first:], r.force_kN[first:]) for r in whole]
        runs = runs_of(cut)
        assert all(0.2 < run.start_noise_mm < 0.6 for run in runs)
        posterior, start = find_start(make_likelihood(runs, DeviceModel(2, read_priors("afc"))))
        tops.append(start)
    sd = np.sqrt(np.diag(tops[0].covariance))
    assert np.all(np.abs(tops[1].free - tops[0].free)[: posterior.model.n_law] < 0.3 * sd[: posterior.model.n_law])


def test_a_device_at_rest_begins_where_it_is(make_small: Make) -> None:
    run = make_small(n_runs=1).runs[0]
    rest = np.concatenate([np.zeros(12), run.recording.displacement_mm])
    force = np.concatenate([np.zeros(12), run.recording.force_kN])
    (still,) = runs_of([Recording(np.arange(rest.size) / 6.0, rest, force)])
    assert still.start_force_kN == 0.0
    assert still.start_noise_mm == still.motion.noise_mm
    assert run.start_noise_mm > still.start_noise_mm


@pytest.mark.parametrize(("power", "in_motion"), [(1.0, True), (2.0, False), (3.0, False)])
def test_a_test_that_starts_gently_begins_at_rest(power: float, in_motion: bool) -> None:
    """At full speed from the first reading, or at a constant acceleration, or one that grows."""
    time = np.arange(400) / 100.0
    out = np.where(time < 1.0, time**power / power, time - 1.0 + 1.0 / power)
    x = 20.0 * np.minimum(out, np.maximum(2.0 * out[200] - out, -out[200]))
    (run,) = runs_of([Recording(time, x, 50.0 * np.tanh(x / 4.0))])
    assert (run.start_noise_mm > run.motion.noise_mm) == in_motion
    assert (run.start_force_kN == 0.0) or in_motion


def test_fingerprint_names_what_differs(make_small: Make) -> None:
    base = make_small().fingerprint
    assert make_small().fingerprint == base
    for field, other in {
        "recordings": make_small(seed=2),
        "parameters": make_small(free=("K",)),
        "noise": make_small(noise="student"),
        "model": with_model(make_small(), variant="continuous"),
        "priors": make_small(priors=read_priors("general")),
    }.items():
        changed = {k for k in base if base[k] != other.fingerprint[k]}
        assert field in changed
        more = {"parameters", "priors"} if field in ("parameters", "noise") else set()  # other parameters, other laws
        assert changed <= {field, *more}


@pytest.mark.parametrize("channel", ["time_s", "force_kN", "used"])
def test_fingerprint_sees_a_single_sample(make_small: Make, channel: str) -> None:
    small = make_small(n_runs=1)
    recording = small.runs[0].recording
    values = np.array(getattr(recording, channel))
    values[17] = not values[17] if channel == "used" else values[17] + 1e-9
    run = Run(dataclasses.replace(recording, **{channel: values}), small.runs[0].motion)
    changed = make_likelihood([run], small.model)
    assert changed.fingerprint["recordings"] != small.fingerprint["recordings"]


def test_fingerprint_sees_how_well_the_displacement_is_known(make_small: Make) -> None:
    small = make_small(n_runs=1)
    run = small.runs[0]
    noisy = Run(run.recording, dataclasses.replace(run.motion, noise_mm=0.05))
    assert make_likelihood([noisy], small.model).fingerprint["recordings"] != small.fingerprint["recordings"]


def test_an_effect_that_leaves_no_force_has_no_density(make_small: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    small = make_small(effects=("slack",))
    monkeypatch.setattr(likelihood_module, "log_density", no_number)
    assert np.all(small.log_posterior_free(points(small, 2)) == -np.inf)


@pytest.mark.parametrize("noise", ["slow", "independent", "student"])
def test_displacement_noise_makes_steep_parts_count_less(make_small: Make, noise: str) -> None:
    """The noise of the force is what is left: a residual where the force is steep is no surprise any more."""
    small = make_small(n_runs=1, noise=noise)
    run = small.runs[0]
    theta = small.model.laws.natural(np.zeros((1, len(small.model.names))))
    theta[0, small.model.names.index("K")] = 30.0
    wobbly = make_likelihood([Run(run.recording, dataclasses.replace(run.motion, noise_mm=0.3))], small.model)
    assert wobbly.log_likelihood(theta)[0] > small.log_likelihood(theta)[0] + 10.0


def test_parts_that_do_not_fit(make_small: Make) -> None:
    small = make_small()
    with pytest.raises(InferenceError, match="1 runs given, the model has 2"):
        make_likelihood(small.runs[:1], small.model)
    _, other = exact_motion((Block(12.0, 0.13, 2),), 20.0)
    with pytest.raises(InferenceError, match=re.escape("motion has") + r" \d+ samples, the recording \d+"):
        Run(small.runs[0].recording, other)
    recording = small.runs[0].recording
    newtons = dataclasses.replace(recording, force_kN=recording.force_kN * 1000)
    with pytest.raises(PriorError, match=r"the force reaches .* kN, but priors 'afc' are for .* check the unit"):
        make_likelihood([Run(newtons, small.runs[0].motion), small.runs[1]], small.model)
