"""Further channels over time, without their noise: bolt tension, temperature, and whatever else was recorded.

A channel is averaged on an even grid and smoothed by local parabolas; the window is the one that predicts each average
best from its neighbours (leave-one-out, in closed form for a linear filter; Allen 1974, Technometrics 16, 125).
"""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from shj_bayes._util.arrays import freeze
from shj_bayes.recording.limits import CHANNEL_CELLS, CHANNEL_FOLLOWS, CHANNEL_GAP, CHANNEL_NOISE
from shj_bayes.recording.recording import Extra, FloatArray
from shj_bayes.recording.smoothing import grid_of

SHORTEST, WIDER, PARABOLA = 5, 1.5, 2


class Refusal(StrEnum):
    """Why nothing can be said over a channel."""

    MISSING = "missing"  # not in every run
    GAPS = "gaps"
    CONSTANT = "constant"  # within its noise
    FOLLOWS_FORCE = "follows_force"


@dataclass(frozen=True, eq=False)
class Channel:
    """A further channel of one run, without its noise."""

    name: str
    unit: str
    time_s: FloatArray  # shape (n,): time since the first sample of the run, s
    values: FloatArray  # shape (n,): in its unit; of a refused channel without numbers there are none
    refused: Refusal | None = None  # why nothing can be said over it; None where it can serve
    # what was found against the limit: the longest gap as a share of the run, the share of the variance that is noise
    # or that is shared with the force. 0 where neither was looked at.
    share: float = 0.0

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        freeze(self, "time_s", "values")


def channel_of(extra: Extra, time_s: FloatArray, force_kN: FloatArray) -> Channel:
    """Take the noise off a further channel or say why it cannot serve; times and force are those of its samples."""
    since = time_s - time_s[0]
    known = np.flatnonzero(np.isfinite(extra.values))
    gap = float(np.diff(since[known], prepend=0.0, append=since[-1]).max() / since[-1])
    if known.size < SHORTEST or gap > CHANNEL_GAP:
        return Channel(extra.name, extra.unit, np.zeros(0), np.zeros(0), Refusal.GAPS, gap)
    time = since[known]
    step = max(float(np.median(np.diff(time))), since[-1] / CHANNEL_CELLS)
    grid = grid_of(time, extra.values[known], 0.0, step)
    smoothed, left = _smoothed(grid.values)
    found = Channel(extra.name, extra.unit, grid.time, smoothed)
    whole = float(np.var(smoothed))
    noise = min(left / whole, 1.0) if np.ptp(smoothed) > 1e-9 * np.abs(smoothed).max() else 1.0
    if noise > CHANNEL_NOISE:
        return replace(found, refused=Refusal.CONSTANT, share=noise)
    shared = float(np.corrcoef(np.interp(since, grid.time, smoothed), force_kN)[0, 1]) ** 2
    return replace(found, refused=Refusal.FOLLOWS_FORCE, share=shared) if shared > CHANNEL_FOLLOWS else found


def _smoothed(values: FloatArray) -> tuple[FloatArray, float]:
    """Smooth evenly spaced values; give them and the variance of the noise that is left in them."""
    # Most recordings have no further channel, and every command reads recordings.
    from scipy.signal import savgol_coeffs, savgol_filter  # noqa: PLC0415

    best, out = np.inf, (values, 0.0)
    width = float(SHORTEST)
    while width <= max(values.size / 3, SHORTEST) and values.size >= SHORTEST:
        window = 2 * round((width - 1) / 2) + 1
        own = float(savgol_coeffs(window, PARABOLA)[window // 2])  # weight of a value in its own mean
        smoothed = savgol_filter(values, window, PARABOLA)
        error = float(np.mean((values - smoothed) ** 2))
        if error / (1.0 - own) ** 2 < best:
            # Of a fit by least squares, the noise left is that weight times the noise; the residual holds the rest.
            best, out = error / (1.0 - own) ** 2, (smoothed, own * error / (1.0 - own))
        width *= WIDER
    return out


def at_samples(extra_s: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Values of a channel at the samples of a recording, on straight lines; NaN where no number is near.

    Known values have ascending times `extra_s`, both of shape (m,); `time_s` has shape (n_samples,).
    """
    if extra_s.size == 0:
        return np.full(time_s.size, np.nan)
    last = extra_s.size - 1
    after = np.searchsorted(extra_s, time_s)
    to_before = time_s - extra_s[np.maximum(after - 1, 0)]
    to_after = extra_s[np.minimum(after, last)] - time_s
    apart = np.where(after == 0, to_after, np.where(after > last, to_before, to_before + to_after))
    near = (apart <= CHANNEL_GAP * (time_s[-1] - time_s[0])) | (to_after == 0.0)
    return np.where(near, np.interp(time_s, extra_s, values), np.nan)
