"""Intervals that do not trust the noise model: chance does not widen them, a model that is wrong does."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.inference.binning import Run
from shj_bayes.inference.convergence import FEWEST, FitVerdict, Widening, _scores, widening_of
from shj_bayes.inference.fit import fit, with_widening
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.inference.start import Start, find_start
from shj_bayes.model.simulate import Truth
from shj_bayes.recording.motion import Block

Make = Callable[..., Likelihood]
LONG = (Block(12.0, 0.13, 4), Block(24.0, 0.067, 4), Block(48.0, 0.034, 4))
SLOW = Truth(gamma=0.01, ratio=0.8, sigma=0.3, phi=0.0, sigma_slow=1.5, tau_slow=5.0, displacement_noise_mm=0.0)


def with_force(posterior: Likelihood, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Likelihood:
    """The same device with another measured force, change(displacement, force)."""
    runs = [
        Run(replace(r.recording, force_kN=change(r.motion.displacement_mm, r.recording.force_kN)), r.motion)
        for r in posterior.runs
    ]
    return make_likelihood(runs, posterior.model)


def pried(posterior: Likelihood) -> Likelihood:
    """Clamping lost away from mid-stroke: the force falls by 12 % towards 48 mm."""
    return with_force(posterior, lambda x, force: force * (1 - 0.12 * (x / 48.0) ** 2))


def test_a_model_that_is_right_is_not_widened(make_small: Make) -> None:
    """At the level of one per cent, eight devices give 0.1 alarms; two or more have a chance of 0.3 %."""
    widenings = [widening_of(*find_start(make_small(blocks=LONG, seed=seed))) for seed in range(8)]
    assert sum(bool(widening.widened) for widening in widenings) < 2
    law = np.array([widening.scatter[:5] for widening in widenings])  # the wider of two estimates: a little above 1
    assert 0.8 < np.median(law) < 1.4


def test_slow_noise_taken_for_independent_is_widened(make_small: Make) -> None:
    wrong = widening_of(*find_start(make_small(SLOW, blocks=LONG, seed=3, noise="independent")))
    right = widening_of(*find_start(make_small(SLOW, blocks=LONG, seed=3)))
    assert {"Fy", "ratio"} <= set(wrong.widened)
    assert wrong.factor[wrong.names.index("Fy")] > 2.0
    assert not right.widened


def test_a_law_that_is_wrong_alike_in_all_cycles_is_widened(make_small: Make) -> None:
    widening = widening_of(*find_start(pried(make_small(blocks=LONG, seed=4))))
    assert {"Fy", "gamma"} <= set(widening.widened)


def test_noise_of_another_size_in_some_cycles_is_widened(make_small: Make) -> None:
    """A sixth of the samples carries five times the noise: of what they tell, the intervals are too narrow."""
    rng = np.random.default_rng(5)
    small = make_small(blocks=LONG, seed=5)

    def loud(x: np.ndarray, force: np.ndarray) -> np.ndarray:
        part = np.arange(x.size) < x.size / 6
        return np.asarray(force + part * 4.0 * np.repeat(rng.standard_normal(x.size // 3 + 1), 3)[: x.size])

    assert widening_of(*find_start(with_force(small, loud))).widened


@pytest.fixture(scope="module")
def misfit(make_small: Make):
    """A finished fit of the pried device, by a plan that is long enough for chains that are in order."""
    small = pried(make_small(blocks=LONG, seed=4))
    return fit(small.runs, small.model, plan=SamplingPlan(max_steps=2000, threads=1))


def test_a_fit_shows_the_wider_intervals_and_is_not_reliable(misfit) -> None:
    assert misfit.widening.widened
    assert misfit.verdict.word != "reliable"
    words = misfit.verdict.reasons[-1]
    assert words.startswith("the cycles scatter more than the model and its noise allow")
    assert f"over {misfit.widening.n_pieces} cycles" in words
    _, start = find_start(misfit.likelihood)
    gaussian = np.sqrt(np.diag(start.covariance))
    shown = misfit.likelihood.model.laws.unbounded(draws_of(misfit)).std(axis=0)
    i = misfit.widening.names.index("Fy")
    assert shown[i] == pytest.approx(gaussian[i] * misfit.widening.factor[i], rel=0.2)
    cycles = misfit.record.cycles
    assert cycles.n_pieces == misfit.widening.n_pieces
    assert cycles.widening["Fy"] == misfit.widening.factor[i] > 1.0
    assert cycles.scatter_over_posterior["Fy"] >= cycles.widening["Fy"]


def draws_of(result) -> np.ndarray:
    return np.stack([result.data.posterior[name].to_numpy().ravel() for name in result.likelihood.model.names], axis=1)


def test_the_table_and_the_stored_draws_are_as_wide_as_each_other(misfit) -> None:
    table = misfit.summary.set_index("name")
    np.testing.assert_allclose(draws_of(misfit).std(axis=0), table["sd"], rtol=0.1)
    np.testing.assert_allclose(draws_of(misfit).mean(axis=0), table["mean"], atol=0.1 * table["sd"].max())


def test_few_cycles_say_nothing(make_small: Make) -> None:
    widening = widening_of(*find_start(make_small(n_runs=1, blocks=(Block(24.0, 0.067, FEWEST - 1),))))
    assert widening.n_pieces == 0
    assert not widening.widened
    assert np.all(widening.factor == 1.0)


def test_no_interval_is_wider_than_its_prior(make_small: Make) -> None:
    posterior, start = find_start(pried(make_small(blocks=LONG, seed=4)))
    # As if the data hardly told the parameters: the cycles scatter more, the prior holds.
    wide = Start(start.free, 0.5 * np.eye(start.free.size), start.log_posterior)
    assert widening_of(posterior, wide).factor.max() <= 1.0 / np.sqrt(0.5) + 1e-12


def test_the_state_at_the_beginning_is_left_out(make_small: Make) -> None:
    """One cycle holds all that is known of it: leaving that out says nothing of how well it is known."""
    posterior, start = find_start(make_small(blocks=LONG, effects=("slack",), noise="independent", truth=SLOW))
    widening = widening_of(posterior, start)
    assert widening.widened
    assert widening.factor[widening.names.index("slack.start")] == 1.0


def test_scores_add_up_to_the_pull_of_the_prior(make_small: Make) -> None:
    """At the top the slope of the likelihood is that of the standard normal prior, reversed."""
    posterior, start = find_start(make_small(blocks=LONG, seed=2))
    scores = _scores(posterior, start)
    assert scores.shape == (sum(run.motion.n_half for run in posterior.runs), start.free.size)
    sd = np.sqrt(np.diag(start.covariance))
    np.testing.assert_allclose(scores.sum(axis=0) * sd, start.free * sd, atol=0.05)


def test_spreading_keeps_the_centre() -> None:
    widening = Widening(("a", "b"), np.array([1.0, 3.0]), np.array([0.9, 3.0]), 12)
    chains = np.random.default_rng(1).normal(5.0, 1.0, (4, 100, 2))
    centre = chains.reshape(-1, 2).mean(axis=0)
    wider = widening.spread(chains, centre)
    np.testing.assert_allclose(wider.reshape(-1, 2).mean(axis=0), centre, rtol=1e-12)
    np.testing.assert_allclose(wider.std(axis=(0, 1)), chains.std(axis=(0, 1)) * [1.0, 3.0], rtol=1e-12)
    assert np.array_equal(wider[..., 0], centre[0] + (chains[..., 0] - centre[0]))
    assert widening.widened == ("b",)


@pytest.mark.parametrize(("before", "after"), [("reliable", "tentative"), ("unusable", "unusable")])
def test_a_widened_fit_is_tentative_at_best(before: str, after: str) -> None:
    wide = Widening(("K", "Fy"), np.array([1.0, 2.34]), np.array([1.0, 2.34]), 12)
    verdict = with_widening(FitVerdict(before, ("converged",)), wide)
    assert verdict.word == after
    assert verdict.reasons[0] == "converged"
    assert "(Fy 2.3 times, over 12 cycles): the intervals of Fy are as wide as that" in verdict.reasons[1]
    narrow = replace(wide, factor=np.ones(2))
    assert with_widening(FitVerdict(before, ("converged",)), narrow) == FitVerdict(before, ("converged",))
