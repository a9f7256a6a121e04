"""Every registered law variant and noise model through the same checks: whoever adds one gets these tests with it."""

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from shj_bayes.inference.problem import Problem

from shj_bayes.inference.predictive import add_noise, log_likelihood_of_half_cycles
from shj_bayes.inference.start import find_start
from shj_bayes.model.law import BETA_RANGE, VARIANTS, force_of_laws
from shj_bayes.model.noise import Stretches, log_density, log_density_terms, simulate_noise
from shj_bayes.model.parameters import BASE, NOISE_PARAMETERS, SHAREABLE, Layout
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.protocol import exact_motion, table_1

UNITS = {"kN/mm", "kN", "1", "s/mm", "mm", "mm/s", "s"}
N = 60


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

    def test_fits_its_own_recording(self, variant: str, make_small: Callable[..., Problem]) -> None:
        problem = make_small(variant=variant)
        theta = problem.natural(find_start(problem).free[None])[0]
        values = dict(zip(problem.layout.names, theta, strict=True))
        assert values["Fy"] == pytest.approx(80.0, rel=0.05)
        assert values["ratio"] == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("model", NOISE_PARAMETERS)
class TestNoise:
    """One noise model."""

    stretches = Stretches(np.arange(N) % 17 != 3, np.array([0, 25]))

    def parameters(self, model: str, m: int) -> dict[str, np.ndarray]:
        """Every parameter of a model, m times."""
        values = {"sigma": 1.2, "phi": 0.7, "nu": 4.0}
        return {name: np.full(m, values[name]) for name in NOISE_PARAMETERS[model]}

    def test_shape_type_and_finite(self, model: str) -> None:
        residual = np.random.default_rng(1).normal(0, 50, (5, N))
        value = log_density(model, residual, self.stretches, **self.parameters(model, 5))
        assert value.shape == (5,)
        assert value.dtype == np.float64
        assert np.all(np.isfinite(value))
        one = {k: float(v[0]) for k, v in self.parameters(model, 1).items()}
        terms = log_density_terms(model, residual[0], self.stretches, **one)
        assert terms.shape == (N,)
        assert terms.sum() == pytest.approx(value[0], rel=1e-12)
        series = simulate_noise(model, self.stretches, np.random.default_rng(1), **one)
        assert series.shape == (N,)
        assert np.all(np.isfinite(series))

    def test_inputs_are_left_alone_and_may_be_read_only(self, model: str) -> None:
        residual = np.random.default_rng(1).normal(0, 1, (3, N))
        copy = residual.copy()
        parameters = self.parameters(model, 3)
        for array in (residual, *parameters.values()):
            array.setflags(write=False)
        log_density(model, residual, self.stretches, **parameters)
        assert np.array_equal(residual, copy)

    def test_scale_is_a_scale(self, model: str) -> None:
        """Residuals and sigma in other units: the density changes by the factor of the unit and by nothing else."""
        residual = np.random.default_rng(2).normal(0, 1, (1, N))
        kN, N_ = self.parameters(model, 1), self.parameters(model, 1)
        N_["sigma"] = 1000 * N_["sigma"]
        difference = log_density(model, residual, self.stretches, **kN) - log_density(
            model, 1000 * residual, self.stretches, **N_
        )
        assert difference[0] == pytest.approx(self.stretches.n_used * np.log(1000), rel=1e-12)

    def test_mirror_image_is_as_likely(self, model: str) -> None:
        residual = np.random.default_rng(3).normal(0, 1, (4, N))
        parameters = self.parameters(model, 4)
        forward = log_density(model, residual, self.stretches, **parameters)
        assert np.array_equal(log_density(model, -residual, self.stretches, **parameters), forward)

    def test_simulated_noise_prefers_its_own_parameters(self, model: str) -> None:
        """The mean log density of simulated series is largest at the parameters they were simulated with."""
        stretches = Stretches(np.ones(400, dtype=bool), np.array([0, 150]))
        rng = np.random.default_rng(4)
        truth = {k: float(v[0]) for k, v in self.parameters(model, 1).items()}
        series = np.stack([simulate_noise(model, stretches, rng, **truth) for _ in range(60)])

        def mean(**change: float) -> float:
            values = {k: np.full(60, v) for k, v in (truth | change).items()}
            return float(log_density(model, series, stretches, **values).mean())

        for name, value in truth.items():
            assert mean() > max(mean(**{name: 0.8 * value}), mean(**{name: 1.25 * value})), name

    def test_whole_problem(
        self, model: str, make_small: Callable[..., Problem], as_vector: Callable[..., np.ndarray]
    ) -> None:
        problem = make_small(noise=model, free=SHAREABLE)
        theta = np.repeat(as_vector(problem), 3, axis=0)
        assert np.all(np.isfinite(problem.log_likelihood(theta)))
        np.testing.assert_allclose(
            log_likelihood_of_half_cycles(problem, theta).sum(axis=1), problem.log_likelihood(theta), rtol=1e-11
        )
        clean = np.zeros((3, sum(run.recording.n_samples for run in problem.runs)))
        assert np.all(np.isfinite(add_noise(problem, theta, clean, np.random.default_rng(1))))
        assert not clean.any()

    def test_parameters_are_described_and_have_priors(self, model: str) -> None:
        layout = Layout(3, model, SHAREABLE)
        for parameter in layout.parameters:
            assert parameter.unit in UNITS, parameter
            assert parameter.meaning
            for family in ("afc", "general"):
                assert read_priors(family).of(parameter.name).unit == parameter.unit


def test_registries_and_descriptions_agree() -> None:
    assert {name for names in NOISE_PARAMETERS.values() for name in names} | {
        "K",
        "Fy",
        "beta",
        "gamma",
        "ratio",
    } == set(BASE)


def test_values_survive_pickling(small_device: Problem, as_vector: Callable[..., np.ndarray]) -> None:
    """Campaigns send problems to other processes."""
    copy = pickle.loads(pickle.dumps(small_device))
    theta = as_vector(small_device)
    assert np.array_equal(copy.log_likelihood(theta), small_device.log_likelihood(theta))
    assert copy.fingerprint == small_device.fingerprint
