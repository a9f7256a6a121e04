"""White noise alone, r_i ~ N(0, sigma^2), for comparison with least squares: too narrow for real noise."""

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.noise.noise import SIGMA, Noise, NoiseComponents, Values, gaussian


def parts(values: Values) -> NoiseComponents:
    """No slow part."""
    return gaussian(values["sigma"], np.zeros_like(values["sigma"]))


def decay(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Nothing is remembered."""
    return np.zeros((seconds.size, values["sigma"].size))


NOISE = Noise(id="independent", own=(SIGMA,), parts=parts, decay=decay)
