"""First-order autoregressive noise at the recorded rate, for comparison with the literature.

r_i = phi r_(i-1) + sigma sqrt(1 - phi^2) z_i, z ~ N(0, 1): the parameters hold for this sampling rate only.
"""

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.noise.noise import SIGMA, Noise, NoiseComponents, NoiseParameter, Values, gaussian

PHI = NoiseParameter(
    "phi",
    "1",
    "lag-one noise correlation at the sampling rate",
    (-0.3, 0.3, 0.8, 0.98),
    (0.1, 0.8),
    0.5,
    bounds=(-1.0, 1.0),
)


def parts(values: Values) -> NoiseComponents:
    """All of the noise is correlated, none of it white."""
    return gaussian(np.zeros_like(values["sigma"]), values["sigma"])


def decay(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Autocorrelation phi^k at a lag of k samples; a gap counts as a whole number of samples."""
    return np.asarray(np.power(values["phi"], np.rint(seconds[:, None] / step_s)))


NOISE = Noise(id="ar1", own=(SIGMA, PHI), parts=parts, decay=decay)
