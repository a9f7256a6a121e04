"""The posterior of the benchmark device in numpy at its best: the likelihood that the peers are given."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes.inference.likelihood import Likelihood

_LOG_2PI = math.log(2 * math.pi)


def saturate(e: FloatArray, w: FloatArray, capacity: float, beta: float) -> None:
    """Eq. (1) of the elastic force `e`, in place and without overflow; `w` is memory of the same shape."""
    np.abs(e, out=w)
    np.maximum(w, 1e-280, out=w)
    w *= 1.0 / capacity
    np.log(w, out=w)
    w *= beta
    np.abs(w, out=w)
    np.negative(w, out=w)
    np.exp(w, out=w)
    np.log1p(w, out=w)
    w *= -1.0 / beta
    np.exp(w, out=w)
    np.clip(e, -capacity, capacity, out=e)
    e *= w


def around(values: FloatArray) -> FloatArray:
    """Change from the sample before to the one after, at the ends from or to the sample itself."""
    return np.diff(values, prepend=values[0]) + np.diff(values, append=values[-1])


@dataclass(frozen=True, eq=False)
class _Run:
    """What of one run does not depend on the parameters, and memory."""

    since_mm: FloatArray  # displacement since the turning point, shape (n,)
    speed_mm_s: FloatArray  # shape (n,)
    measured_kN: FloatArray  # shape (n,)
    lengths: IntArray  # samples of each half-cycle
    legs_mm: list[float]  # from each turning point to the next
    start_force_kN: float  # rate-free force at the first sample
    start_noise_mm: float  # standard deviation of the displacement at which the run begins
    around_mm: FloatArray  # displacement from the sample before to the one after, in the first half-cycle
    columns: FloatArray  # memory, shape (3, n): see `_log_noise`
    memory: FloatArray  # shape (n,)


class NumpyPosterior:
    """Log posterior of one parameter set at a time, all samples of a run in one pass.

    Parameters
    ----------
    posterior : Likelihood
        Two runs, white and slow noise, the published reversal rule, even sampling, every sample used, no noise of the
        displacement. What is not known beside the parameters, the load cell's zero and the displacement at which each
        run begins, is integrated out as ours is.
    """

    def __init__(self, posterior: Likelihood) -> None:
        """Lay out what does not depend on the parameters."""
        self.model, self.n = posterior.model, 0
        zero_kN = posterior.blocks[0].timing.zero_noise_kN
        self.runs = []
        for run in posterior.runs:
            assert run.used.all()
            assert run.motion.noise_mm == 0.0
            m = run.motion
            lengths = np.diff(m.start)
            since = m.displacement_mm - np.repeat(m.turning_mm, lengths)
            columns = np.zeros((3, since.size))
            columns[1] = zero_kN
            self.runs.append(
                _Run(
                    since,
                    m.speed_mm_s,
                    run.recording.force_kN,
                    lengths,
                    np.diff(m.turning_mm).tolist(),
                    run.start_force_kN,
                    run.start_noise_mm,
                    around(m.displacement_mm[: lengths[0]]),
                    columns,
                    np.empty_like(since),
                )
            )
        self.step_s = 1 / posterior.runs[0].recording.rate_Hz

    def log_likelihood(self, theta: FloatArray) -> float:
        """Log likelihood of K, Fy, beta, gamma, ratio, sigma_white, sigma_slow, tau_slow."""
        K, Fy, beta, gamma, ratio, white, slow, tau = (float(value) for value in theta)
        total = 0.0
        for number, run in enumerate(self.runs):
            e, w = run.columns[0], run.memory
            capacity = Fy * (ratio if number else 1.0)
            resets = [run.start_force_kN]
            for leg in run.legs_mm:
                value = K * leg + resets[-1]
                power = beta * math.log(max(abs(value) / capacity, 1e-290))
                soft = max(power, 0.0) + math.log1p(math.exp(-abs(power)))
                resets.append(value * math.exp(-soft / beta))
            np.multiply(run.since_mm, K, out=e)
            e += np.repeat(resets, run.lengths)
            saturate(e, w, capacity, beta)
            np.multiply(run.speed_mm_s, gamma, out=w)
            w += 1.0
            e *= w
            slope = around(e[: run.lengths[0]]) / run.around_mm
            np.subtract(run.measured_kN, e, out=e)
            np.multiply(slope, run.start_noise_mm, out=run.columns[2, : slope.size])
            total += _log_noise(run.columns, slope.size, white**2, slow**2, math.exp(-self.step_s / tau))
        return total

    def __call__(self, z: FloatArray) -> float:
        """Log posterior of one point of the unbounded space."""
        self.n += 1
        if not np.all(np.abs(z) < 30):
            return -math.inf
        row = np.asarray(z, dtype=np.float64)[None]
        with np.errstate(all="ignore"):
            value = self.log_likelihood(self.model.laws.natural(row)[0]) + float(self.model.laws.log_density(row)[0])
        return value if math.isfinite(value) else -math.inf

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior of many points, one after the other, shape (m,)."""
        return np.array([self(row) for row in z])


def _log_noise(columns: FloatArray, n_first: int, white: float, slow: float, decay: float) -> float:
    """Log density of white and slow noise of given variances, evenly sampled, and of two errors of unit variance.

    Rows of `columns`, shape (3, n), are the residual and what either error adds to it, the second one to the first
    `n_first` samples only. The Kalman gain settles within some dozen samples; from there on what is new in a row is a
    recursive filter of it.
    """
    n = columns.shape[1]
    state, variance, log_det = np.zeros(3), slow, 0.0
    new = np.empty_like(columns)
    for i in range(n):
        spread = variance + white
        gain = variance / spread
        after = decay**2 * variance * (1 - gain) + slow * (1 - decay**2)
        if abs(after - variance) <= 1e-14 * spread:
            log_det += (n - i) * math.log(spread)
            scale, back = 1 / math.sqrt(spread), [1.0, -decay * (1 - gain)]
            for row, end in enumerate((n, n, n_first)):
                began = [-state[row] * scale]
                new[row, i:end] = lfilter([scale, -decay * scale], back, columns[row, i:end], zi=began)[0]
            break
        log_det += math.log(spread)
        news = columns[:, i] - state
        new[:, i] = news / math.sqrt(spread)
        state, variance = decay * (state + gain * news), after
    residual, zero, start = new[0], new[1], new[2, :n_first]
    a, b = 1 + float(zero @ zero), float(zero[:n_first] @ start)
    c = 1 + float(start @ start)
    with_zero, with_start, both = float(zero @ residual), float(start @ residual[:n_first]), a * c - b * b
    left = (c * with_zero**2 - 2 * b * with_zero * with_start + a * with_start**2) / both
    return -0.5 * float(residual @ residual - left + log_det + math.log(both) + n * _LOG_2PI)
