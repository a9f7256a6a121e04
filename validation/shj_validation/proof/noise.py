"""Force noise of a trial: the kinds that real load cells show, stated in seconds, one standard deviation for all."""

import numpy as np
from scipy.signal import lfilter

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError

NOISES = ("white", "ar1", "white and slow", "more at low speed", "slow drift", "rounded")
HUM, WITH_FORCE = "with hum", "growing with the force"
ALL_NOISES = (*NOISES, HUM, WITH_FORCE)  # the earlier kind of proof draws the first six
MEMORIES_S = (1.0, 3.0, 30.0)  # of the slow part of "white and slow"
MAINS_HZ, WANDERS_HZ, WANDERS_S = 50.0, 0.02, 100.0  # frequency, its standard deviation and memory
SHORT_S, LONG_S = 0.3, 150.0  # memory of an amplifier's filter, and of a load cell in the draught


def force_noise(
    kind: str,
    speed_mm_s: FloatArray,
    dt_s: float,
    sd_kN: float,
    memory_s: float,
    rng: np.random.Generator,
    force_kN: FloatArray | float = 0.0,
) -> FloatArray:
    """Draw the force noise of one run; it means the same at any sampling rate.

    Parameters
    ----------
    kind : str
        One of `ALL_NOISES`; what "rounded" is rounded to is a property of the recorder.
    speed_mm_s : array, shape (n,)
        Speed at each sample, mm/s.
    dt_s : float
        Sampling interval, s.
    sd_kN : float
        Standard deviation of the whole, kN.
    memory_s : float
        Memory of the slow part of "white and slow", s.
    rng : numpy.random.Generator
        Source of chance.
    force_kN : array, shape (n,), or float
        Force without noise, for the kind that grows with it, kN.

    Returns
    -------
    array, shape (n,)
        Noise, kN.
    """
    n = speed_mm_s.size
    white = rng.standard_normal(n)
    if kind in ("white", "rounded"):
        series = white
    elif kind == "ar1":
        series = slow(n, dt_s, SHORT_S, rng)
    elif kind == "white and slow":
        series = 0.8 * white + 0.6 * slow(n, dt_s, memory_s, rng)
    elif kind == "more at low speed":
        series = 0.8 * white + 0.6 * slow(n, dt_s, SHORT_S, rng)
        series = series * np.where(speed_mm_s < 0.4 * np.percentile(speed_mm_s, 95), 2.0, 1.0)
        series = series / np.sqrt(np.mean(series**2))
    elif kind == "slow drift":
        series = 0.9 * white + 0.44 * slow(n, dt_s, LONG_S, rng)
    elif kind == HUM:
        turns = np.cumsum(MAINS_HZ + WANDERS_HZ * slow(n, dt_s, WANDERS_S, rng)) * dt_s
        series = 0.6 * white + 0.8 * np.sqrt(2.0) * np.sin(2 * np.pi * (turns + rng.random()))
    elif kind == WITH_FORCE:
        series = white * (0.3 + np.abs(force_kN) / max(np.abs(force_kN).max(), 1e-9))
        series = series / np.sqrt(np.mean(series**2))
    else:
        raise ModelError(f"noise '{kind}' is not known; choose one of {', '.join(ALL_NOISES)}")
    return np.asarray(sd_kN * series)


def slow(n: int, dt_s: float, memory_s: float, rng: np.random.Generator) -> FloatArray:
    """Draw an Ornstein-Uhlenbeck process of unit variance at even times: its correlation falls by e in `memory_s`."""
    keep = np.exp(-dt_s / memory_s)
    draw = rng.standard_normal(n)
    draw[0] /= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], draw))
