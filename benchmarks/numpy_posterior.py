"""The posterior of the benchmark device in numpy at its best: the likelihood that the peers are given."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from shj_bayes.inference.posterior import Posterior
from shj_bayes.model.parameters import FloatArray

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


class NumpyPosterior:
    """Log posterior of one parameter set at a time, all samples of a run in one pass.

    Parameters
    ----------
    posterior : Posterior
        Two runs, white and slow noise, the published reversal rule, even sampling, every sample used, no noise of the
        displacement.
    """

    def __init__(self, posterior: Posterior) -> None:
        """Lay out what does not depend on the parameters."""
        self.model, self.n = posterior.model, 0
        self.runs = []
        for run in posterior.runs:
            assert run.used.all()
            assert run.motion.noise_mm == 0.0
            m = run.motion
            lengths = np.diff(m.start)
            since = m.displacement_mm - np.repeat(m.turning_mm, lengths)
            memory = (np.empty_like(since), np.empty_like(since))
            self.runs.append(
                (since, m.speed_mm_s, run.recording.force_kN, lengths, np.diff(m.turning_mm).tolist(), memory)
            )
        self.step_s = 1 / posterior.runs[0].recording.rate_Hz

    def log_likelihood(self, theta: FloatArray) -> float:
        """Log likelihood of K, Fy, beta, gamma, ratio, sigma_white, sigma_slow, tau_slow."""
        K, Fy, beta, gamma, ratio, white, slow, tau = (float(value) for value in theta)
        total = 0.0
        for number, (since, speed, measured, lengths, legs, memory) in enumerate(self.runs):
            e, w = memory
            capacity = Fy * (ratio if number else 1.0)
            resets = [0.0]
            for leg in legs:
                value = K * leg + resets[-1]
                power = beta * math.log(max(abs(value) / capacity, 1e-290))
                soft = max(power, 0.0) + math.log1p(math.exp(-abs(power)))
                resets.append(value * math.exp(-soft / beta))
            np.multiply(since, K, out=e)
            e += np.repeat(resets, lengths)
            saturate(e, w, capacity, beta)
            np.multiply(speed, gamma, out=w)
            w += 1.0
            e *= w
            np.subtract(measured, e, out=e)
            total += _log_noise(e, white**2, slow**2, math.exp(-self.step_s / tau))
        return total

    def __call__(self, z: FloatArray) -> float:
        """Log posterior of one point of the unbounded space."""
        self.n += 1
        if not np.all(np.abs(z) < 30):
            return -math.inf
        row = np.asarray(z, dtype=np.float64)[None]
        with np.errstate(all="ignore"):
            value = self.log_likelihood(self.model.natural(row)[0]) + float(self.model.log_prior(row)[0])
        return value if math.isfinite(value) else -math.inf

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior of many points, one after the other, shape (m,)."""
        return np.array([self(row) for row in z])


def _log_noise(residual: FloatArray, white: float, slow: float, decay: float) -> float:
    """Log density of white and slow noise of given variances, evenly sampled.

    The Kalman gain settles within some dozen samples; from there on its news is a recursive filter of the residual.
    """
    state, variance, total, n = 0.0, slow, 0.0, residual.size
    for i, r in enumerate(residual.tolist()):
        spread = variance + white
        gain, new = variance / spread, r - state
        after = decay**2 * variance * (1 - gain) + slow * (1 - decay**2)
        if abs(after - variance) <= 1e-14 * spread:
            news = lfilter([1.0, -decay], [1.0, -decay * (1 - gain)], residual[i:], zi=[-state])[0]
            return total - 0.5 * (float(news @ news) / spread + (n - i) * math.log(spread) + n * _LOG_2PI)
        total -= 0.5 * (new * new / spread + math.log(spread))
        state, variance = decay * (state + gain * new), after
    return total - 0.5 * n * _LOG_2PI
