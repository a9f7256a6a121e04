"""How noisy a measured displacement is, and whether it comes in counts of an encoder."""

import numpy as np

from shj_bayes.recording.recording import FloatArray

_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
_THIRD = np.array([1.0, -3.0, 3.0, -1.0])
_THIRD_NORM = float(np.sqrt(np.sum(_THIRD**2)))


def resolution_of(values: FloatArray) -> float:
    """Step of an encoder or converter in a channel of shape (n,), 0 when the values come in no steps that matter.

    It is the smallest spacing of the levels, when these repeat so often that rounding is the larger part of the noise.
    """
    levels = np.unique(values)
    if levels.size < 3 or levels.size > values.size / 3:
        return 0.0
    spacing = np.diff(levels)
    # Levels that differ by rounding in the last printed digit are one level.
    spacing = spacing[spacing > 1e-9 * float(np.ptp(levels))]
    return float(np.percentile(spacing, 10)) if spacing.size else 0.0


def noise_of(values: FloatArray, resolution: float | None = None) -> float:
    """Estimate the standard deviation of the fast part of a slowly varying channel, shape (n_samples,), nearly even.

    Third differences cancel every parabola, so the motion does not count as noise; their median absolute value
    does not see the few samples at corners. Rounding to counts (`resolution`, found when not given) adds at least a
    uniform error. In the unit of the values; 0 for fewer than 8 samples.
    """
    if values.size < 8:
        return 0.0
    count = resolution_of(values) if resolution is None else resolution
    third = np.convolve(values, _THIRD, mode="valid") / _THIRD_NORM
    if count > 0.0:
        # Most differences of a slow staircase are zero, which blinds the median: use the mean square without the
        # rare largest, which are corners.
        size = np.abs(third)
        spread = float(np.sqrt(np.mean(np.minimum(size, np.percentile(size, 99.0)) ** 2)))
        return max(spread, count / float(np.sqrt(12.0)))
    return _MAD * float(np.median(np.abs(third)))
