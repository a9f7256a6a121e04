"""Local polynomials through evenly spaced samples, in numpy alone.

The same numbers as `scipy.signal.savgol_filter` and `scipy.interpolate.CubicHermiteSpline`, whose imports take longer
than reading and checking a recording.
"""

from functools import lru_cache
from math import factorial

import numpy as np

from shj_bayes._util.frozen_arrays import frozen
from shj_bayes.recording.recording import FloatArray


@lru_cache(maxsize=256)
def weights(window: int, degree: int, derivative: int = 0, step: float = 1.0) -> FloatArray:
    """Weights whose sum of products with a window of samples is the polynomial's derivative at its middle.

    Savitzky and Golay 1964, Analytical Chemistry 36, 1627-1639. `window` is an odd number of samples, above `degree`;
    `step` is their spacing; derivative 0 is the value.
    """
    solve = _powers(window, degree)[1]
    return frozen(solve[derivative] * (factorial(derivative) / (window // 2 * step) ** derivative))


def filtered(values: FloatArray, window: int, degree: int, step: float) -> tuple[FloatArray, FloatArray]:
    """Value and slope, shape (n,), of the local polynomial at every sample; the ends use the last whole window.

    `values` holds at least `window` samples; `window`, `degree` and `step` are as for `weights`.
    """
    (powers, solve), half = _powers(window, degree), window // 2
    slopes = np.column_stack([k * powers[:, max(k - 1, 0)] for k in range(degree + 1)])
    value, slope = np.empty(values.size), np.empty(values.size)
    inner = slice(half, values.size - half)
    value[inner] = np.correlate(values, weights(window, degree), "valid")
    slope[inner] = np.correlate(values, weights(window, degree, 1, step), "valid")
    for piece, rows, at in (
        (values[:window], slice(None, half), slice(None, half)),
        (values[-window:], slice(half + 1, None), slice(values.size - half, None)),
    ):
        found = solve @ piece
        value[at], slope[at] = powers[rows] @ found, slopes[rows] @ found / (half * step)
    return value, slope


@lru_cache(maxsize=64)
def _powers(window: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Powers of the places in a window from -1 to 1, shape (window, degree + 1), and their pseudo-inverse."""
    half = window // 2
    powers = np.vander(np.arange(-half, half + 1) / half, degree + 1, increasing=True)
    return frozen(powers), frozen(np.linalg.pinv(powers))


def hermite(knots: FloatArray, values: FloatArray, slopes: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and slope, shape (m,), of the cubics that have the values and slopes at increasing knots, shape (n,).

    Beyond the ends the last cubic goes on.
    """
    k = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    width = (knots[1:] - knots[:-1])[k]
    u = (at - knots[k]) / width
    rise, first, last = values[k + 1] - values[k], width * slopes[k], width * slopes[k + 1]
    bend, twist = 3 * rise - 2 * first - last, first + last - 2 * rise
    value = values[k] + u * (first + u * (bend + u * twist))
    return np.asarray(value), np.asarray((first + u * (2 * bend + u * 3 * twist)) / width)
