"""Noise that is rougher, or smoother, at low speed: rigs hunt and friction sticks where the motion is slow.

At rest the standard deviation of the noise is exp(at_rest) times that at speed, with a smooth passage between the two.
"""

import math

import numpy as np

from shj_bayes.model.parameters import FloatArray

LOW_SPEED = 0.4  # of the peak speed, below which the noise may be another one
ROUGHER = 0.7  # sd before the test of the logarithm of its ratio: a factor of two either way


def slowness(speed_mm_s: FloatArray, peak_mm_s: float) -> FloatArray:
    """How far each speed is a low one, 1 at rest to 0 at the peak."""
    return np.asarray(np.exp(-((speed_mm_s / (LOW_SPEED * peak_mm_s)) ** 2)))


def rougher(at_rest: float, slow: FloatArray) -> FloatArray:
    """Give the standard deviation of the noise over that at speed, from its logarithm at rest and from `slowness`."""
    return np.asarray(1.0 + math.expm1(at_rest) * slow)
