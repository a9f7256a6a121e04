"""Verdicts pinned on synthetic chains whose state is known."""

import dataclasses

import emcee
import numpy as np
import pytest
from scipy.signal import lfilter

from shj_bayes.inference.convergence import (
    Diagnostics,
    autocorrelation_time,
    burn_in,
    diagnose_chains,
    judge,
)

NAMES = ("K", "Fy")


def chains(n_steps: int, tau: float = 1.0, n_walkers: int = 12, seed: int = 1) -> np.ndarray:
    """Four ensembles of AR(1) walkers of unit variance with integrated time tau, shape (4, n_steps, n_walkers, 2)."""
    rng = np.random.default_rng(seed)
    a = (tau - 1) / (tau + 1)
    z = rng.standard_normal((4, n_steps, n_walkers, 2)) * np.sqrt(1 - a**2)
    z[:, 0] /= np.sqrt(1 - a**2)
    return np.asarray(lfilter([1.0], [1.0, -a], z, axis=1))


def verdict(x: np.ndarray, acceptance: np.ndarray | float = 0.3) -> tuple[str, str, Diagnostics]:
    accepted = np.broadcast_to(np.asarray(acceptance, dtype=float), (x.shape[0], x.shape[2]))
    figures = diagnose_chains(NAMES, list(x), accepted)
    outcome = judge(figures)
    return outcome.word, " | ".join(outcome.reasons), figures


def test_all_fine() -> None:
    word, reasons, figures = verdict(chains(2000, tau=10.0))
    assert word == "reliable", reasons
    assert judge(figures).word == "reliable"
    assert "4 independent ensembles agree" in reasons
    assert np.all(figures.rhat < 1.01)
    np.testing.assert_allclose(figures.tau, 10.0, rtol=0.2)
    # 12 walkers and 4 ensembles of kept steps, each worth 1/tau
    np.testing.assert_allclose(figures.ess_bulk, 48 * figures.n_steps / 10.0, rtol=0.25)


def test_too_short_is_not_reliable_and_says_so() -> None:
    word, reasons, figures = verdict(chains(300, tau=20.0))
    assert word == "tentative"
    assert "autocorrelation times long (50 is wanted); run longer" in reasons
    assert judge(figures).word != "reliable"


def test_much_too_short_is_unusable() -> None:
    x = np.cumsum(chains(60), axis=1)  # random walks: nothing has mixed
    assert verdict(x)[0] == "unusable"


def test_two_modes_are_unusable() -> None:
    """Ensembles in different modes: each looks fine alone, only the comparison shows it."""
    x = chains(2000, tau=5.0)
    x[2:, ..., 0] += 5.0
    word, reasons, figures = verdict(x)
    assert word == "unusable"
    assert "R-hat of K" in reasons
    assert "two peaks" in reasons
    assert figures.rhat[0] > 1.3
    assert figures.rhat[1] < 1.01


def test_one_ensemble_in_another_mode_is_seen() -> None:
    x = chains(2000, tau=5.0)
    x[3, ..., 1] += 1.0
    word, reasons, _ = verdict(x)
    assert word != "reliable"
    assert "R-hat of Fy" in reasons
    x[3, ..., 1] += 2.0
    assert verdict(x)[0] == "unusable"


def test_stuck_walkers() -> None:
    x = chains(2000, tau=5.0)
    acceptance = np.full((4, 12), 0.3)
    x[0, :, 0] = x[0, 0, 0]
    acceptance[0, 0] = 0.0
    word, reasons, _ = verdict(x, acceptance)
    assert word != "reliable"
    assert "2 % of the walkers accept fewer than 5 %" in reasons
    x[:, :, :6] = x[:, :1, :6]
    acceptance[:, :6] = 0.0
    word, reasons, _ = verdict(x, acceptance)
    assert word == "unusable"
    assert "50 % of the walkers accept fewer" in reasons


def test_nothing_moves_at_all() -> None:
    """No variance, no R-hat: that must not pass for agreement, nor warn."""
    x = np.broadcast_to(chains(1)[:1, :1, :1], (4, 200, 12, 2)).copy()
    word, _, figures = verdict(x, 0.0)
    assert word == "unusable"
    assert np.all(np.isinf(figures.rhat))
    assert figures.lengths == 0.0


def test_one_parameter_stands_still() -> None:
    x = chains(2000, tau=5.0)
    x[..., 1] = 3.0
    word, reasons, _ = verdict(x)
    assert word == "unusable"
    assert "Fy" in reasons


def test_drift_is_not_reliable() -> None:
    """All ensembles drift together: they agree with one another but not with their own past."""
    x = chains(2000, tau=5.0)
    x += np.linspace(0.0, 3.0, 2000)[None, :, None, None]
    assert verdict(x)[0] != "reliable"


@pytest.mark.parametrize("tau", [1.0, 8.0, 40.0])
def test_autocorrelation_time_of_known_chains(tau: float) -> None:
    measured = autocorrelation_time(list(chains(6000, tau=tau)))
    np.testing.assert_allclose(measured, tau, rtol=0.12)


@pytest.mark.parametrize(("tau", "n", "expected"), [(3.2, 1000, 32), (30.0, 400, 200), (0.95, 100, 10)])
def test_burn_in(tau: float, n: int, expected: int) -> None:
    assert burn_in(tau, n) == expected


FINE = Diagnostics(
    NAMES,
    tau=np.array([20.0, 20.0]),
    rhat=np.array([1.002, 1.003]),
    ess_bulk=np.array([1500.0, 2000.0]),
    ess_tail=np.array([1500.0, 2000.0]),
    acceptance=np.full((4, 12), 0.3),
    n_steps=1200,
    n_burn=200,
)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({}, "reliable"),
        ({"rhat": np.array([1.002, 1.0101])}, "tentative"),
        ({"rhat": np.array([1.002, 1.11])}, "unusable"),
        ({"rhat": np.array([1.002, np.inf])}, "unusable"),
        ({"ess_bulk": np.array([999.0, 2000.0])}, "tentative"),
        ({"ess_bulk": np.array([99.0, 2000.0])}, "unusable"),
        ({"ess_tail": np.array([1500.0, 99.0])}, "unusable"),
        ({"n_steps": 990}, "tentative"),
        ({"tau": np.array([20.0, np.inf])}, "tentative"),
        ({"acceptance": np.full((4, 12), 0.01)}, "unusable"),
    ],
)
def test_each_criterion_on_its_own(change: dict[str, object], word: str) -> None:
    outcome = judge(dataclasses.replace(FINE, **change))
    assert outcome.word == word
    assert outcome.reasons


@pytest.mark.parametrize("n", [60, 105, 1001])
@pytest.mark.parametrize("tau", [1.0, 8.0, 40.0])
def test_autocorrelation_time_is_that_of_emcee(tau: float, n: int) -> None:
    x = chains(n, tau=tau)
    expected = np.maximum(np.mean([emcee.autocorr.integrated_time(c, tol=0, quiet=True) for c in x], axis=0), 1.0)
    np.testing.assert_allclose(autocorrelation_time(list(x)), expected, rtol=1e-12)
