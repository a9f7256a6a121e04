"""Intervals of the law with effects: the sampled posterior, no narrower than the cycles and the displacement allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from shj_bayes.inference.problem import Run
from shj_bayes.inference.sampler import Plan
from shj_bayes.mismatch.evidence import Evidence, evidence_of
from shj_bayes.mismatch.posterior import augmented_posterior, sample
from shj_bayes.mismatch.refit import Refit, refit
from shj_bayes.mismatch.thresholds import FORMULA_SPREAD
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior, Priors
from shj_bayes.recording.kinematics import motion_of

N_COPIES = 4  # of the displacement with as much noise again
POLISH = 6  # steps of least squares from parameters that are right but for the noise
N_DRAWS = 2000
SAME_AMPLITUDE = 0.05  # of the largest: cycles of one block
FEWEST_BLOCKS = 4  # fewer say nothing of their scatter


@dataclass(frozen=True)
class Effort:
    """How much to spend on intervals.

    Parameters
    ----------
    samples : int
        About how many samples the posterior is sampled on; denser ones are correlated and cost time.
    steps : int
        Steps of each ensemble at most; an augmented law that does not fit mixes slowly, and says so.
    progress : bool
        Show a progress bar.
    threads : int
        Ensembles at a time, 0 for as many as there are processors.
    """

    samples: int = 4000
    steps: int = 2000
    progress: bool = False
    threads: int = 0


def approximate(evidence: Evidence, fit: Refit, seed: int) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Draws of a first look: around the least-squares fit, as wide as the jackknife over cycles says."""
    draws = around(fit, _factor(fit) * jackknife(evidence, fit), seed)
    return draws, {"how": "jackknife over cycles (first look)", "verdict": "tentative"}


def sampled(
    runs: Sequence[Run], evidence: Evidence, fit: Refit, priors: Priors, *, seed: int, effort: Effort
) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Draws from the posterior, spread to what the posterior does not know of.

    It believes in AR(1) noise, in the effect's formula and in a displacement without error. The scatter from cycle to
    cycle tells of the first two (on simulators that are not the catalogue's formulas the posterior alone covered 22 of
    48 truths, with the jackknife 35), `of_displacement` of the third.

    Parameters
    ----------
    runs : sequence of Run
        The recordings.
    evidence : Evidence
        The same, as the effects were found on it.
    fit : Refit
        Law with effects.
    priors : Priors
        Of base parameters and noise.
    seed : int
        Same seed, same draws.
    effort : Effort
        Samples, steps, threads.

    Returns
    -------
    dict of str to array, dict
        Draws in natural units by parameter; how they were made and the verdict on them.
    """
    thin = evidence_of(runs, effort.samples)
    start = refit(thin, fit.model, [fit.z])
    plan = Plan(seed=seed, max_steps=effort.steps)
    draws, verdict = sample(
        augmented_posterior(thin, start, priors), start, plan, progress=effort.progress, threads=effort.threads
    )
    rows, moved = jackknife(evidence, fit), of_displacement(runs, start, effort.samples, seed)
    if verdict.word != "reliable":  # the mean of walkers on several hills is on none of them
        words = f"jackknife over cycles, as emcee did not settle in {effort.steps} steps"
        both = np.concatenate([rows, np.diag(moved)])
        return around(fit, _factor(fit) * both, seed), {"how": words, "verdict": "tentative"}
    cycles = np.linalg.norm(rows, axis=0)
    pairs = zip(fit.model.names, fit.model.priors, cycles, moved, strict=True)
    draws |= {n: _widened(draws[n], prior, (float(a), float(b)), _factor(fit)) for n, prior, a, b in pairs}
    words = f"emcee on every {thin.stride}. sample; {'; '.join(verdict.reasons)}; "
    return draws, {
        "how": words + "no narrower than the cycles and the displacement's noise allow",
        "verdict": verdict.word,
    }


def jackknife(evidence: Evidence, fit: Refit) -> FloatArray:
    """Estimate the covariance of the free parameters by leaving data out: rows R of R'R, shape (n_left_out, d).

    One cycle at a time, and one stretch of equal amplitude at a time; the larger of both counts. A law that is a little
    wrong is wrong alike in all cycles of a block: only leaving out whole blocks shows by how much the parameters
    depend on which amplitudes were tested.
    """
    spread = _left_out(fit, np.asarray(evidence.block_edges))
    place = np.round(evidence.stack("amplitude_mm") / (SAME_AMPLITUDE * evidence.histories[0].half_stroke_mm))
    changes = np.flatnonzero((np.diff(place) != 0) | (np.diff(evidence.run) != 0)) + 1
    edges = np.concatenate([[0], changes, [place.size]])
    if edges.size - 1 < FEWEST_BLOCKS:
        return spread
    few = float(stats.t.ppf(0.95, edges.size - 2) / stats.norm.ppf(0.95))
    own, of_blocks = (np.linalg.norm(rows, axis=0) for rows in (spread, few * _left_out(fit, edges)))
    return np.asarray(spread * np.maximum(1.0, of_blocks / np.maximum(own, 1e-300)))


def _left_out(fit: Refit, edges: NDArray[np.int64]) -> FloatArray:
    """Jackknife over stretches of samples; each refit is one Gauss-Newton step."""
    gram = fit.jacobian.T @ fit.jacobian + fit.rmse_kN**2 * np.eye(fit.z.size)
    steps = []
    for a, b in pairwise(edges):
        j = fit.jacobian[a:b]
        steps.append(np.linalg.lstsq(gram - j.T @ j, -j.T @ fit.residual_kN[a:b], rcond=1e-10)[0])
    moved = np.stack(steps)
    n = moved.shape[0]
    return np.asarray(np.sqrt((n - 1) / n) * (moved - moved.mean(axis=0)))


def of_displacement(runs: Sequence[Run], fit: Refit, n_samples: int, seed: int) -> FloatArray:
    """Root mean square move of the free parameters when the displacement gets as much noise again, shape (d,).

    Noise in what a law is driven by biases its parameters; to first order, noise added again moves them by the same
    amount again (simulation and extrapolation: Cook and Stefanski 1994, Journal of the American Statistical Association
    89, 1314-1328). The move is taken into the width, not subtracted: its sign is known no better than its size.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(8,)))
    moves = []
    for _ in range(N_COPIES):
        shaken = [_shaken(run, rng) for run in runs]
        again = refit(evidence_of(shaken, n_samples), fit.model, [fit.z], rounds=POLISH)
        moves.append(again.z - fit.z)
    return np.asarray(np.sqrt(np.mean(np.square(moves), axis=0)))


def _shaken(run: Run, rng: np.random.Generator) -> Run:
    """Add the displacement's own noise to it once more."""
    noise = run.motion.noise_mm * rng.standard_normal(run.recording.n_samples)
    recording = replace(run.recording, displacement_mm=run.recording.displacement_mm + noise)
    return Run(recording, motion_of(recording))


def around(fit: Refit, rows: FloatArray, seed: int) -> dict[str, FloatArray]:
    """Draw from a normal law in the free space, no wider than the prior, which has the standard deviation 1 there.

    With its correlations: a test without friction to speak of leaves Fy and what is a share of it open, but not their
    product (346 N of pressure on a seal).
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    root = rows / np.maximum(np.linalg.norm(rows, axis=0), 1.0)
    return natural(fit, fit.z + rng.standard_normal((N_DRAWS, rows.shape[0])) @ root)


def natural(fit: Refit, z: FloatArray) -> dict[str, FloatArray]:
    """Free vectors, shape (n, d), as draws of each parameter in its own unit."""
    return {
        name: prior.from_free(z[:, i])
        for i, (name, prior) in enumerate(zip(fit.model.names, fit.model.priors, strict=True))
    }


def _factor(fit: Refit) -> float:
    """By how much intervals are widened for formulas that are not the device's."""
    return FORMULA_SPREAD if fit.model.effects else 1.0


def _widened(draws: FloatArray, prior: Prior, least: tuple[float, float], factor: float) -> FloatArray:
    """Spread draws to the jackknife's standard error where they are narrower, by the displacement's share, and on."""
    z = prior.to_free(draws)
    spread = float(z.std())
    if not spread > 0 or not np.all(np.isfinite(z)):
        return draws
    cycles, displacement = least
    wanted = min(factor * float(np.hypot(max(spread, cycles), displacement)), max(spread, 1.0))
    return prior.from_free(z.mean() + (z - z.mean()) * (wanted / spread))
