"""What the posterior predicts: the force at points of the recordings, and the mean force of every half-cycle."""

import math

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes.inference.binning import BinnedRun, Run
from shj_bayes.inference.likelihood import Likelihood, variance_over_speed
from shj_bayes.model.filter import Timing, density_and_zero, table_of
from shj_bayes.model.history import thinned
from shj_bayes.model.noise import Noise, Values

PIECE = 50  # parameter sets at a time, so that memory stays small


def points_of(run: Run, n_points: int) -> IntArray:
    """Every k-th sample of a run, about `n_points` in all, and the first of every half-cycle."""
    n, first = run.recording.n_samples, run.motion.start[:-1]
    every = math.ceil(n / max(1, n_points - (first.size if n > n_points else 0)))
    return np.union1d(np.arange(0, n, every), first)


def force_at_points(
    likelihood: Likelihood, theta: FloatArray, points: tuple[IntArray, ...], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Force at points of all runs (`points_of`) one after the other, for parameter sets of shape (m, d), kN.

    Without noise, and as it would be measured, both of shape (m, n_points of all runs).
    """
    model, values = likelihood.model, likelihood.model.noise_values(theta)
    clean, noise = [], []
    for run, course, keep in zip(likelihood.runs, likelihood.histories, points, strict=True):
        recording = run.recording
        history = course if keep.size == recording.n_samples else thinned(course, keep)
        clean.append(model.force(theta, history, run.start_force_kN))
        step, anew = 1.0 / recording.rate_Hz, np.diff(np.cumsum(recording.restarts)[keep]) > 0
        gap = np.where(anew, np.inf, np.round(np.diff(recording.time_s[keep]) / step, 3) * step)
        gaps, kind = np.unique(np.append(np.inf, gap), return_inverse=True)
        kinds = np.stack([np.ones(gaps.size), np.full(gaps.size, step), gaps], axis=1)
        rough = variance_over_speed(likelihood.at_rest, history)
        timing = Timing(kind, kinds, history.motion.start, step, 0.0, np.zeros(run.motion.n_half), rough=rough)
        drawn = draw_noise(model.noise, values, np.zeros((theta.shape[0], keep.size)), timing, rng)
        noise.append(drawn + rng.normal(*zero_of_run(likelihood, theta, len(clean)))[:, None])
    law = np.concatenate(clean, axis=1)
    return law, law + np.concatenate(noise, axis=1)


def zero_of_run(likelihood: Likelihood, theta: FloatArray, run: int) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the error of the load cell's zero in a run, for each parameter set, kN."""
    part, model = likelihood.blocks[run - 1], likelihood.model
    held = part.residual_and_slope(part.force(model, theta))
    return density_and_zero(model.noise, model.noise_values(theta), *held, part.timing)[1:]


def half_cycles(
    likelihood: Likelihood, theta: FloatArray, rng: np.random.Generator, *, tested: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean force of each half-cycle's evidence in the direction of motion: how likely, and what is predicted.

    For parameter sets of shape (m, d): log likelihood of each half-cycle given those before it, and its mean force as
    it would be measured (kN), both of shape (m, n_half of all runs); its measured mean force, NaN where no sample is
    evidence. The zero of the load cell is what the recordings say or, unless `tested`, what was known before the test.
    """
    likely, predicted, measured = [], [], []
    noise = likelihood.model.noise
    pieces = np.array_split(theta, math.ceil(theta.shape[0] / PIECE))
    for part in likelihood.blocks:
        log_likelihood, force = [], []
        for some in pieces:
            values = likelihood.model.noise_values(some)
            residual, slope = part.residual_and_slope(part.force(likelihood.model, some))
            density, mean, sd = density_and_zero(noise, values, residual, slope, part.timing)
            if not tested:
                mean, sd = np.zeros_like(mean), np.full_like(sd, part.timing.zero_noise_kN)
            log_likelihood.append(density)
            drawn = draw_noise(noise, values, slope, part.timing, rng) + rng.normal(mean, sd)[:, None]
            force.append(_means(part.force_kN - residual + drawn, part))
        likely.append(np.concatenate(log_likelihood))
        predicted.append(np.concatenate(force))
        measured.append(_means(part.force_kN, part))
    return np.concatenate(likely, axis=1), np.concatenate(predicted, axis=1), np.concatenate(measured)


def _means(force_kN: FloatArray, part: BinnedRun) -> FloatArray:
    """Mean over the evidence of each half-cycle, in the direction of motion, of a force by blocks, shape (..., n)."""
    first = part.timing.half[:-1]
    total = np.add.reduceat(force_kN * part.count, first, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(part.history.motion.direction * total / np.add.reduceat(part.count, first))


def draw_noise(noise: Noise, values: Values, slope: FloatArray, timing: Timing, rng: np.random.Generator) -> FloatArray:
    """Draw averaged residuals whose density `log_density` gives where the zero is known, shape (m, n), kN."""
    parts = noise.parts(values)
    table = table_of(noise, values, timing)
    heavy = np.isfinite(parts.nu)
    out = rng.standard_normal(slope.shape)
    if heavy.any():
        out[heavy] = rng.standard_t(parts.nu[heavy, None], out[heavy].shape)
    of_turn = timing.turning_noise_mm * rng.standard_normal((out.shape[0], timing.half.size - 1)) * ~heavy[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        _draw(
            out,
            slope,
            timing.kind,
            timing.share,
            table,
            timing.half,
            parts.white_kN**2,
            parts.slow_kN**2,
            timing.displacement_noise_mm**2,
            heavy[:, None] * timing.turning_noise_mm**2,
            of_turn,
        )
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(  # type: ignore[no-untyped-def]  # noqa: PLR0913, PLR0917
    out, slope, kind, share, table, half, white, slow, noise_x, noise_turn, of_turn
):
    """Turn standard draws into residuals: the recursion of the likelihood, driven by what is new."""
    for j in range(out.shape[0]):
        s, p = 0.0, slow[j]
        for k in range(half.size - 1):
            for i in range(half[k], half[k + 1]):
                c = kind[i]
                if c < 0:
                    out[j, i] = 0.0
                    continue
                h, f, steep = table[j, c, 0], table[j, c, 1], slope[j, i]
                variance = h * h * p + slow[j] * table[j, c, 2] + white[j] * share[i, 0]
                variance += (noise_x * share[i, 1] + noise_turn[j, k]) * steep * steep
                new = math.sqrt(variance) * out[j, i]
                gain = (h * f * p + slow[j] * table[j, c, 4]) / variance
                out[j, i] = h * s + new + of_turn[j, k] * steep
                s = f * s + gain * new
                p = max(f * f * p + slow[j] * table[j, c, 3] - gain * gain * variance, 0.0)
