"""The posterior of the benchmark device in numpy at its best: the likelihood that the peers are given."""

from __future__ import annotations

import math

import numpy as np
from shj_bayes.inference.problem import Problem

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
    problem : Problem
        Two runs, AR(1) noise, the published reversal rule, every sample used.
    """

    def __init__(self, problem: Problem) -> None:
        """Lay out what does not depend on the parameters."""
        self.problem, self.n = problem, 0
        self.runs = []
        for run in problem.runs:
            m = run.motion
            lengths = np.diff(m.start)
            since = m.displacement_mm - np.repeat(m.turning_mm, lengths)
            memory = (np.empty_like(since), np.empty_like(since))
            self.runs.append(
                (since, m.speed_mm_s, run.recording.force_kN, lengths, np.diff(m.turning_mm).tolist(), memory)
            )

    def log_likelihood(self, theta: FloatArray) -> float:
        """Log likelihood of K, Fy, beta, gamma, ratio, sigma, phi."""
        K, Fy, beta, gamma, ratio, sigma, phi = (float(value) for value in theta)
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
            np.multiply(e[:-1], phi, out=w[1:])
            np.subtract(e[1:], w[1:], out=w[1:])
            n = e.size
            innovation = float(np.dot(w[1:], w[1:])) / (1 - phi**2)
            total -= 0.5 * ((float(e[0]) ** 2 + innovation) / sigma**2 + n * _LOG_2PI)
            total -= n * math.log(sigma) + 0.5 * (n - 1) * math.log1p(-(phi**2))
        return total

    def __call__(self, z: FloatArray) -> float:
        """Log posterior of one point of the unbounded space."""
        self.n += 1
        if not np.all(np.abs(z) < 30):
            return -math.inf
        row = np.asarray(z, dtype=np.float64)[None]
        with np.errstate(all="ignore"):
            value = self.log_likelihood(self.problem.natural(row)[0]) + float(self.problem.log_prior_free(row)[0])
        return value if math.isfinite(value) else -math.inf

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior of many points, one after the other, shape (m,)."""
        return np.array([self(row) for row in z])
