"""Every registered law variant and noise model through the same checks: whoever adds one gets these tests with it."""

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.predictive import draw_noise, force_at_points, points_of
from shj_bayes.inference.start import find_start
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model import noise
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.model.filter import Timing, log_density, simulate
from shj_bayes.model.law import BETA_RANGE, VARIANTS, force_of_laws
from shj_bayes.model.noise import (
    SIGMA,
    Noise,
    NoiseParameter,
    gaussian,
    noise_model,
    noise_models,
    noise_parameters,
)
from shj_bayes.model.parameters import LAW_PARAMETERS, SHAREABLE, base_parameters
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.motion import exact_motion, table_1

UNITS = {"kN/mm", "kN", "1", "s/mm", "mm", "mm/s", "s"}
N = 60
STEP = 0.05
# Values of the noise parameters; of those that are not named, the median of the prior.
VALUES = {name: float(prior.quantile(0.5)) for name, prior in read_priors("afc").priors.items()} | {
    "sigma": 1.2,
    "phi": 0.7,
    "sigma_white": 1.2,
    "sigma_slow": 0.9,
    "tau_slow": 0.3,
    "nu": 4.0,
}


def singles(n: int, breaks: tuple[int, ...], unused: tuple[int, ...] = ()) -> Timing:
    """Samples on their own in two half-cycles; at breaks the noise begins anew, unused ones are no evidence."""
    kinds = np.array([[1, STEP, np.inf], [1, STEP, STEP]])
    kind = np.where(np.isin(np.arange(n), breaks), 0, 1)
    kind[list(unused)] = -1
    return Timing(kind, kinds, np.array([0, n // 2, n]), STEP, 0.0, np.zeros(2))


def laws() -> np.ndarray:
    """Ordinary and extreme parameter sets."""
    rows = [
        (K, Fy, beta, g)
        for K in (0.5, 18.0, 300.0)
        for Fy in (2.0, 90.0)
        for beta in (*BETA_RANGE, 10.0)
        for g in (-0.03, 0.05)
    ]
    return np.array(rows)


@pytest.mark.parametrize("variant", VARIANTS)
class TestLaw:
    """One law variant."""

    def test_shape_type_and_finite(self, variant: str) -> None:
        motion = exact_motion(table_1(), 5.0)[1]
        out = force_of_laws(motion, laws(), variant=variant)
        assert out.shape == (len(laws()), motion.displacement_mm.size)
        assert out.dtype == np.float64
        assert np.all(np.isfinite(out))

    def test_inputs_are_left_alone_and_may_be_read_only(self, variant: str) -> None:
        motion = exact_motion(table_1(), 5.0)[1]
        sets = laws()
        sets.setflags(write=False)
        copies = {
            n: getattr(motion, n).copy() for n in ("displacement_mm", "speed_mm_s", "start", "turning_mm", "direction")
        }
        force_of_laws(motion, sets, variant=variant)
        assert np.array_equal(sets, laws())
        for name, values in copies.items():
            assert np.array_equal(getattr(motion, name), values)
            assert not getattr(motion, name).flags.writeable

    def test_bounded_by_the_sliding_force(self, variant: str) -> None:
        motion = exact_motion(table_1(), 5.0)[1]
        still = laws() * np.array([1.0, 1.0, 1.0, 0.0])
        out = force_of_laws(motion, still, variant=variant)
        assert np.all(np.abs(out) <= still[:, 1:2] * (1 + 1e-12))

    def test_works_against_the_motion(self, variant: str) -> None:
        """Friction dissipates: every variant does positive work over the regime when speed does not matter."""
        motion = exact_motion(table_1(), 20.0)[1]
        for row in force_of_laws(motion, laws() * np.array([1.0, 1.0, 1.0, 0.0]), variant=variant):
            assert np.sum(0.5 * (row[1:] + row[:-1]) * np.diff(motion.displacement_mm)) > 0

    def test_fits_its_own_recording(self, variant: str, make_small: Callable[..., Likelihood]) -> None:
        posterior, start = find_start(make_small(variant=variant))
        values = dict(zip(posterior.model.names, posterior.model.laws.natural(start.free[None])[0], strict=True))
        assert values["Fy"] == pytest.approx(80.0, rel=0.05)
        assert values["ratio"] == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("model", noise_models())
class TestNoise:
    """One noise model."""

    timing = singles(N, (0, 25), tuple(range(3, N, 17)))
    flat = np.zeros((5, N))

    def parameters(self, model: str, m: int) -> dict[str, np.ndarray]:
        """Every parameter of a model, m times."""
        return {name: np.full(m, VALUES[name]) for name in noise_model(model).parameters}

    def test_shape_type_and_finite(self, model: str) -> None:
        residual = np.random.default_rng(1).normal(0, 50, (5, N))
        value = log_density(noise_model(model), self.parameters(model, 5), residual, self.flat, self.timing)
        assert value.shape == (5, 2)
        assert value.dtype == np.float64
        assert np.all(np.isfinite(value))
        one = {k: float(v[0]) for k, v in self.parameters(model, 1).items()}
        time, restarts = STEP * np.arange(N), np.isin(np.arange(N), (0, 25))
        series = simulate(noise_model(model), one, time, restarts, np.random.default_rng(1))
        assert series.shape == (N,)
        assert np.all(np.isfinite(series))

    def test_inputs_are_left_alone_and_may_be_read_only(self, model: str) -> None:
        residual = np.random.default_rng(1).normal(0, 1, (3, N))
        slope = np.ones((3, N))
        copies = residual.copy(), slope.copy()
        parameters = self.parameters(model, 3)
        for array in (residual, slope, *parameters.values()):
            array.setflags(write=False)
        log_density(noise_model(model), parameters, residual, slope, self.timing)
        assert np.array_equal(residual, copies[0])
        assert np.array_equal(slope, copies[1])

    def test_scale_is_a_scale(self, model: str) -> None:
        """Residuals and scales in other units: the density changes by the factor of the unit and by nothing else."""
        residual = np.random.default_rng(2).normal(0, 1, (1, N))
        kN = self.parameters(model, 1)
        N_ = {name: (1000 if name.startswith("sigma") else 1) * value for name, value in kN.items()}
        noise, flat = noise_model(model), self.flat[:1]
        difference = log_density(noise, kN, residual, flat, self.timing) - log_density(
            noise, N_, 1000 * residual, flat, self.timing
        )
        assert difference.sum() == pytest.approx(np.sum(self.timing.kind >= 0) * np.log(1000), rel=1e-12)

    def test_mirror_image_is_as_likely(self, model: str) -> None:
        residual = np.random.default_rng(3).normal(0, 1, (4, N))
        parameters, slope = self.parameters(model, 4), np.ones((4, N))
        forward = log_density(noise_model(model), parameters, residual, slope, self.timing)
        assert np.array_equal(log_density(noise_model(model), parameters, -residual, -slope, self.timing), forward)

    def test_simulated_noise_prefers_its_own_parameters(self, model: str) -> None:
        """The mean log density of series that are drawn is largest at the parameters they were drawn with."""
        n = 400
        timing, rng = singles(n, (0, 150)), np.random.default_rng(4)
        truth = {k: float(v[0]) for k, v in self.parameters(model, 1).items()}
        flat = np.zeros((60, n))
        series = draw_noise(noise_model(model), self.parameters(model, 60), flat, timing, rng)

        def mean(**change: float) -> float:
            values = {k: np.full(60, v) for k, v in (truth | change).items()}
            return float(log_density(noise_model(model), values, series, flat, timing).sum(axis=1).mean())

        for name, value in truth.items():
            assert mean() > max(mean(**{name: 0.8 * value}), mean(**{name: 1.25 * value})), name

    def test_whole_posterior(
        self, model: str, make_small: Callable[..., Likelihood], as_vector: Callable[..., np.ndarray]
    ) -> None:
        posterior = make_small(noise=model, free=SHAREABLE)
        theta = np.repeat(as_vector(posterior), 3, axis=0)
        assert np.all(np.isfinite(posterior.log_likelihood(theta)))
        points = tuple(points_of(run, 200) for run in posterior.runs)
        clean, noisy = force_at_points(posterior, theta, points, np.random.default_rng(1))
        assert clean.shape == noisy.shape == (3, sum(own.size for own in points))
        assert np.all(np.isfinite(noisy))
        assert 0.3 < (noisy - clean).std() < 3.0

    def test_parameters_are_described_and_have_priors(self, model: str) -> None:
        for family in ("afc", "general"):
            device = DeviceModel(3, read_priors(family), noise=noise_model(model), free=SHAREABLE)
            for parameter, prior in zip(map(meaning_of, device.names), device.laws, strict=True):
                assert parameter.unit in UNITS, parameter
                assert parameter.meaning
                assert prior.unit == parameter.unit


def test_registries_and_descriptions_agree() -> None:
    assert {name for one in noise_models().values() for name in one.parameters} == set(noise_parameters())
    assert set(noise_parameters()) | set(LAW_PARAMETERS) == set(base_parameters())


def test_a_noise_model_brings_its_own_parameter(
    small_device: Likelihood, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """It names unit, meaning and prior itself; the searches of a fit and of a diagnosis need no value to begin at."""
    law = ("uniform", 0.0, 1.0, "Nothing assumed.")
    share = NoiseParameter("share", "1", "white part of the variance", prior=law, bounds=(0.0, 1.0))
    model = Noise(
        "shared",
        (SIGMA, share),
        parts=lambda v: gaussian(v["sigma"] * np.sqrt(v["share"]), v["sigma"] * np.sqrt(1.0 - v["share"])),
        decay=lambda v, seconds, step_s: np.exp(-np.repeat(seconds[:, None], v["sigma"].size, axis=1)),
    )
    known = {**noise_models(), "shared": model}
    monkeypatch.setattr(noise, "noise_models", lambda: known)
    for names in (noise_parameters, base_parameters):
        names.cache_clear()
        request.addfinalizer(names.cache_clear)
    device = DeviceModel(2, read_priors("afc"), noise=model)
    posterior, start = find_start(make_likelihood(small_device.runs, device))
    values = dict(zip(posterior.model.names, posterior.model.laws.natural(start.free[None])[0], strict=True))
    assert values["sigma"] == pytest.approx(1.0, rel=0.3)  # the root of 0.8^2 + 0.6^2
    assert diagnose(small_device.runs, device, DiagnoseOptions(quick=True)).content["verdict"] == "adequate"


def test_values_survive_pickling(small_device: Likelihood, as_vector: Callable[..., np.ndarray]) -> None:
    """Campaigns send posteriors to other processes."""
    copy = pickle.loads(pickle.dumps(small_device))
    theta = as_vector(small_device)
    assert np.array_equal(copy.log_likelihood(theta), small_device.log_likelihood(theta))
    assert copy.fingerprint == small_device.fingerprint
