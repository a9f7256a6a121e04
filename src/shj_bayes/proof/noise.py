"""Force noise of a trial: the kinds that real load cells show, one standard deviation for all."""

from __future__ import annotations

import numpy as np

from shj_bayes.errors import ModelError
from shj_bayes.model.noise import Stretches, simulate_noise
from shj_bayes.model.parameters import FloatArray

NOISES = ("white", "ar1", "strong ar1", "heavy tails", "more at low speed", "slow drift")


def force_noise(kind: str, speed_mm_s: FloatArray, sd_kN: float, rng: np.random.Generator) -> FloatArray:
    """Draw the force noise of one run.

    Parameters
    ----------
    kind : str
        One of `NOISES`.
    speed_mm_s : array, shape (n,)
        Speed at each sample, mm/s.
    sd_kN : float
        Standard deviation of the whole, kN.
    rng : numpy.random.Generator
        Source of chance.

    Returns
    -------
    array, shape (n,)
        Noise, kN.
    """
    stretches = Stretches(np.ones(speed_mm_s.size, dtype=np.bool_), np.zeros(1, dtype=np.int64))
    if kind == "white":
        series = simulate_noise("independent", stretches, rng, sigma=1.0)
    elif kind == "ar1":
        series = simulate_noise("ar1", stretches, rng, sigma=1.0, phi=0.8)
    elif kind == "strong ar1":
        series = simulate_noise("ar1", stretches, rng, sigma=1.0, phi=0.95)
    elif kind == "heavy tails":
        series = simulate_noise("student", stretches, rng, sigma=1.0, phi=0.7, nu=4.0)
    elif kind == "more at low speed":
        series = simulate_noise("ar1", stretches, rng, sigma=1.0, phi=0.7)
        series = series * np.where(speed_mm_s < 0.4 * np.percentile(speed_mm_s, 95), 2.0, 1.0)
    elif kind == "slow drift":
        series = simulate_noise("ar1", stretches, rng, sigma=1.0, phi=0.7)
        series = series + simulate_noise("ar1", stretches, rng, sigma=0.5, phi=0.998)
    else:
        raise ModelError(f"noise '{kind}' is not known; choose one of {', '.join(NOISES)}")
    return np.asarray(sd_kN * series / series.std())
