"""Force noise of a trial: the kinds that real load cells show, one standard deviation for all."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from shj_bayes.errors import ModelError
from shj_bayes.model.noise.catalogue import noise_model
from shj_bayes.model.noise.filter import simulate
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
    step = np.arange(speed_mm_s.size, dtype=np.float64)  # in samples: AR(1) knows no seconds

    def draw(phi: float, sd: float = 1.0) -> FloatArray:
        return simulate(noise_model("ar1"), {"sigma": sd, "phi": phi}, step, step == 0.0, rng)

    if kind == "white":
        series = draw(0.0)
    elif kind == "ar1":
        series = draw(0.8)
    elif kind == "strong ar1":
        series = draw(0.95)
    elif kind == "heavy tails":
        series = _heavy(0.7, 4.0, step.size, rng)
    elif kind == "more at low speed":
        series = draw(0.7)
        series = series * np.where(speed_mm_s < 0.4 * np.percentile(speed_mm_s, 95), 2.0, 1.0)
    elif kind == "slow drift":
        series = draw(0.7)
        series = series + draw(0.998, 0.5)
    else:
        raise ModelError(f"noise '{kind}' is not known; choose one of {', '.join(NOISES)}")
    return np.asarray(sd_kN * series / series.std())


def _heavy(phi: float, nu: float, n: int, rng: np.random.Generator) -> FloatArray:
    """AR(1) series whose innovations follow Student's t."""
    return np.asarray(lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.standard_t(nu, n)))
