"""Displacement and velocity by a local polynomial whose window follows from the noise and that stops at corners."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise
from math import factorial
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import FloatArray, freeze, frozen
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Column


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

    The places increase as well; beyond the ends the last cubic goes on.
    """
    k = np.repeat(np.arange(knots.size - 1), np.diff(np.searchsorted(at, knots[1:-1]), prepend=0, append=at.size))
    width = np.diff(knots)
    rise, first, last = np.diff(values), width * slopes[:-1], width * slopes[1:]
    bend, twist = 3 * rise - 2 * first - last, first + last - 2 * rise
    u = (at - knots[k]) / width[k]
    first, bend, twist = first[k], bend[k], twist[k]
    value = values[k] + u * (first + u * (bend + u * twist))
    return np.asarray(value), np.asarray((first + u * (2 * bend + u * 3 * twist)) / width[k])


NARROWEST = 3.5  # the window that suits every half-cycle over the narrowest, which follows changes within one
MAX_HALF_WIDTH = 100  # grid points on each side: wider windows are reached by averaging samples first
MAX_CELLS = 20_000_000  # of a grid: a time axis with absurd gaps is no reason to run out of memory
_CUBIC, _QUINTIC = 3, 5


class Samples(NamedTuple):
    """A measured displacement with strictly increasing times, shape (n_samples,), or its means on an even grid."""

    time_s: FloatArray
    values: FloatArray
    noise: float  # standard deviation of the noise of one value
    step: float  # usual sampling interval, s

    def grid(self, half_s: float) -> Samples:
        """Average samples that a window of this half-width (s) need not tell apart."""
        least = float(np.ptp(self.time_s)) / MAX_CELLS
        return self.averaged(max(self.step, half_s / MAX_HALF_WIDTH, least))

    def averaged(self, step: float) -> Samples:
        """Average samples, even or not, in cells of `step` s and place the means on an even grid."""
        time_s, values = self.time_s, self.values
        n = int(np.floor((time_s[-1] - time_s[0]) / step + 1e-6)) + 1
        centres = time_s[0] + step * np.arange(n)
        if n == time_s.size and np.allclose(time_s, centres, rtol=0.0, atol=0.02 * step):
            return Samples(centres, values, self.noise, step)
        since = time_s - time_s[0]
        cell = np.minimum(np.rint(since / step), n - 1).astype(np.int64)
        count = np.bincount(cell, minlength=n)
        filled = count > 0
        mean_time = np.bincount(cell, since, n)[filled] / count[filled] + time_s[0]
        mean_value = np.bincount(cell, values, n)[filled] / count[filled]
        # Times first, values second: interpolating between means keeps a straight line straight whatever the jitter.
        noise = self.noise / np.sqrt(max(1.0, time_s.size / n))
        return Samples(centres, np.interp(centres, mean_time, mean_value), noise, step)


class Smooth(NamedTuple):
    """Smoothed displacement and its velocity at the samples."""

    # values, velocity: shape (n_samples,): mm and mm/s
    values: FloatArray
    velocity: FloatArray
    velocity_sd: FloatArray  # shape (n_samples,): standard deviation of the noise left in ``velocity``, mm/s
    noise: float  # standard deviation of what noise is left in ``values`` with the narrowest window, mm
    half_width_s: tuple[float, float]  # half of the narrowest and of the widest window, s
    # frequency at which the velocity has lost 3 dB, for the widest and the narrowest window
    bandwidth_Hz: tuple[float, float]
    kinks_s: FloatArray  # times of corners, starts and stops at which the windows end, s


def smooth(time_s: FloatArray, values: FloatArray, noise: float, resolution: float, turns: list[int]) -> Smooth:
    """Smooth a measured displacement with strictly increasing times and differentiate it.

    `noise` is the standard deviation of one sample, `resolution` the step of the encoder, 0 when there is none, `turns`
    the samples at which half-cycles end, roughly.
    """
    samples = Samples(time_s, values, noise, float(np.median(np.diff(time_s))))
    # Neighbouring windows differ by the rounding error of a slow staircase without any bias, and noise that is not
    # white is larger than its third differences tell; a ten-thousandth of the range is no bias that a loop shows.
    coloured = min(limits.BIAS_RANGE * float(np.ptp(values)), 4.0 * noise)
    allowed = max(limits.BIAS_SHARE * noise, coloured, resolution / float(np.sqrt(12.0)))
    edges = np.concatenate([[time_s[0]], time_s[turns], [time_s[-1]]])
    half_s = choose_half_width(samples, allowed, edges)
    grid = samples.grid(half_s)
    half = max(2, round(half_s / grid.step))
    kinks_s = grid.time_s[find_kinks(grid, half, allowed, resolution)]
    long = np.flatnonzero(np.diff(time_s) > max(limits.GAP_STEPS * samples.step, grid.step))
    stops = np.sort(np.concatenate([kinks_s, time_s[long], time_s[long + 1]]))
    widths = widen(samples, max(limits.BIAS_SHARE * noise, resolution / float(np.sqrt(12.0))), edges, half_s, stops)
    of_sample = widths[np.searchsorted(time_s[turns], time_s, side="right")]
    narrowest = max(2.0 * samples.step, half_s / NARROWEST)
    position, velocity, error = _narrowed(samples, of_sample, stops, max(allowed, 2.0 * resolution), narrowest)
    kernel = weights(2 * half + 1, _CUBIC)
    return Smooth(
        values=position,
        velocity=velocity,
        velocity_sd=error,
        noise=float(grid.noise * np.sqrt(np.sum(kernel**2))),
        half_width_s=(half * grid.step, float(widths.max())),
        bandwidth_Hz=(bandwidth(half, grid.step) * half * grid.step / float(widths.max()), bandwidth(half, grid.step)),
        kinks_s=kinks_s,
    )


def _narrowed(
    samples: Samples, of_sample: FloatArray, stops: FloatArray, allowed: float, narrowest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and its standard deviation with the given windows, narrower where the curve bends at once.

    Beside a rest, or where a block begins within a half-cycle, its window is wrong by up to a millimetre. So each
    sample keeps the widest window whose curve no narrower one contradicts by `LOCAL_SD` standard deviations, there and
    nearby (Lepski's rule: Goldenshluger and Nemirovski 1997, Mathematical Methods of Statistics 6, 135-170).
    """
    ladder = [float(np.max(of_sample))]
    while ladder[0] / 1.5 >= narrowest:
        ladder.insert(0, ladder[0] / 1.5)
    position, velocity, sd = _curve(samples, ladder[0], stops)
    error = np.full(position.size, sd[1])
    # Intersection of what the narrower windows allow. The wider window holds their samples: the difference varies less
    # than the narrower estimate itself.
    low, high = position - allowed - limits.LOCAL_SD * sd[0], position + allowed + limits.LOCAL_SD * sd[0]
    agrees, index = np.ones(position.size, dtype=np.bool_), np.arange(position.size)
    for width in ladder[1:]:
        x, v, sd = _curve(samples, width, stops)
        agrees &= (low <= x) & (x <= high)
        reach, against = round(width / samples.step) // 2, np.append(0, np.cumsum(~agrees))
        near = against[np.minimum(index + reach + 1, index.size)] - against[np.maximum(index - reach, 0)]
        mine = (width <= of_sample * 1.01) & (near == 0)
        position[mine], velocity[mine], error[mine] = x[mine], v[mine], sd[1]
        low, high = (
            np.maximum(low, x - allowed - limits.LOCAL_SD * sd[0]),
            np.minimum(high, x + allowed + limits.LOCAL_SD * sd[0]),
        )
    return position, velocity, error


def _curve(samples: Samples, half_s: float, stops: FloatArray) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
    """Position, velocity and their standard deviations with one window (half of it, s), by segment."""
    grid = samples.grid(half_s)
    half = max(2, round(half_s / grid.step))
    inner = np.rint((stops - grid.time_s[0]) / grid.step).astype(np.int64)
    breaks = np.unique(np.clip(np.concatenate([[0], inner, [grid.time_s.size - 1]]), 0, grid.time_s.size - 1))
    position, velocity = _by_segment(samples.time_s, grid, half, breaks)
    kernels = [weights(2 * half + 1, _degree(2 * half + 1), k, grid.step) for k in (0, 1)]
    sd_position, sd_velocity = (float(grid.noise * np.sqrt(np.sum(kernel**2))) for kernel in kernels)
    return position, velocity, (sd_position, sd_velocity)


def widen(samples: Samples, allowed: float, edges: FloatArray, half_s: float, stops: FloatArray) -> FloatArray:
    """Half of the window of each half-cycle, s: wider ones for slow half-cycles, by the rule of `choose_half_width`.

    One window for all, `half_s`, is set by the fastest block: at Table 1 it left a bias of 3 standard deviations in Fy
    and gamma at 10 Hz. Half-cycles that touch one of the `stops` (corners and gaps, s) keep it: a wider one would lean
    more on where exactly the corner is. Neighbours differ by a factor of 1.5 at most, since windows reach over.
    """
    width = np.full(edges.size - 1, half_s)
    growing = np.searchsorted(stops, edges[1:] + half_s) <= np.searchsorted(stops, edges[:-1] - half_s)
    before = np.full(width.size, np.inf)
    trial = 1.5 * half_s
    while np.any(growing := growing & (trial <= limits.SHORTEST_SHARE * np.diff(edges))):
        grid = samples.grid(trial)
        change, expected = _changes(grid, edges, (trial / 1.5, trial))
        growing = growing & (change <= np.maximum(np.maximum(allowed, expected), before))  # nan: too short to judge
        width[growing] = trial
        before = np.where(np.isfinite(change), change, before)
        trial *= 1.5
    for order in (range(1, width.size), range(width.size - 2, -1, -1)):
        for k in order:
            width[k] = min(width[k], 1.5 * width[k - order.step])
    return width


def choose_half_width(samples: Samples, allowed: float, edges: FloatArray) -> float:
    """Half of the widest window, s, that moves the curve of no half-cycle by more than `allowed` or noise explains.

    Windows 1.5 times as wide are compared by the median of their difference in each half-cycle, without its ends, so
    that corners and stops do not count as curvature. A fifth of the shortest half-cycle is never exceeded. `edges` are
    the begin, the rough reversals and the end, s.
    """
    # The first and the last half-cycle may be cut short or hold a rest, so only whole ones tell the shortest duration.
    whole = np.diff(edges)[1:-1] if edges.size > 3 else np.diff(edges)
    limit = limits.SHORTEST_SHARE * float(np.min(whole))
    accepted = 2.0 * samples.step
    before = np.full(edges.size - 1, np.inf)
    while accepted * 1.5 <= limit:
        trial = accepted * 1.5
        grid = samples.grid(trial)
        change, expected = _changes(grid, edges, (accepted, trial))
        # Noise that is not white changes the curve more than expected, but less and less as the window grows; a bias
        # grows with its fourth power.
        if np.any(change > np.maximum(np.maximum(allowed, expected), before)):
            break
        accepted, before = trial, np.where(np.isfinite(change), change, before)
    return accepted


def _changes(grid: Samples, edges: FloatArray, widths: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Typical change of each half-cycle from the narrower to the wider window, and what white noise would give."""
    m_narrow, m_wide = (max(2, round(width / grid.step)) for width in widths)
    change, expected = np.full(edges.size - 1, np.nan), np.zeros(edges.size - 1)
    if m_narrow == m_wide or grid.time_s.size <= 2 * m_wide + 1:
        return change, expected
    kernel = weights(2 * m_wide + 1, _CUBIC).copy()
    kernel[m_wide - m_narrow : m_wide + m_narrow + 1] -= weights(2 * m_narrow + 1, _CUBIC)
    moved = np.abs(np.convolve(grid.values, kernel, mode="same"))
    noise = grid.noise * float(np.sqrt(np.sum(kernel**2)))
    margin = max(1.5 * widths[1], 2 * grid.step)
    for k, (begin, end) in enumerate(pairwise(edges)):
        lo, hi = np.searchsorted(grid.time_s, [max(begin, grid.time_s[0]) + margin, min(end, grid.time_s[-1]) - margin])
        if hi - lo >= 3:
            independent = max(1.0, (hi - lo) / m_wide)
            change[k] = float(np.median(moved[lo:hi])) / 0.6745
            expected[k] = noise * (1.0 + 3.0 / np.sqrt(independent))
    return change, expected


def find_kinks(
    grid: Samples, half: int, allowed: float, resolution: float = 0.0
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Places on the grid where the slope jumps: corners of a triangle, starts and stops.

    The coefficient of abs(t) beside a local quintic is a linear filter of the samples; where it stands far out of its
    noise there is a corner. Corners that smoothing would round by less than `allowed` are left to it; what rounding to
    encoder steps (`resolution`) can do alone is no corner, even where counts lie evenly about a top.
    """
    if half < 4 or grid.time_s.size < 4 * half:
        return np.zeros(0, dtype=np.int64)
    u = np.arange(-half, half + 1) / half
    # A quintic beside |u|, so that a smooth peak is no corner; odd powers are orthogonal to |u| already.
    basis = np.column_stack([np.ones_like(u), u**2, u**4])
    hinge = np.abs(u) - basis @ np.linalg.lstsq(basis, np.abs(u), rcond=None)[0]
    kernel = hinge / np.sum(hinge**2)
    inside = np.convolve(grid.values, kernel[::-1], mode="valid")
    scale = grid.noise * float(np.sqrt(np.sum(kernel**2)))
    # Correlated noise (filters, encoder counts, rig ringing) spreads the coefficient more than white noise would.
    scale = max(scale, float(np.median(np.abs(inside))) / 0.6745, 1e-9 * float(np.ptp(grid.values)) + 1e-300)
    # A local cubic rounds |u| by 3/16 at its tip.
    least = max(allowed / 0.1875, 0.5 * resolution * float(np.sum(np.abs(kernel))))
    z = np.where(np.abs(inside) > least, np.abs(inside) / scale, 0.0)
    found: list[int] = []
    near = np.zeros(z.size, dtype=np.bool_)  # within half a window of a corner that stands out more
    for index in np.argsort(-z)[: max(1, 40 * z.size // half)]:
        if z[index] < limits.KINK_Z:
            break
        if not near[index]:
            found.append(int(index))
            near[max(0, index - half) : index + half + 1] = True
    return np.array(sorted(found), dtype=np.int64) + half


def _by_segment(time_s: FloatArray, grid: Samples, half: int, breaks: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Fit every stretch between two breaks by itself and read position and velocity at the samples."""
    position, velocity = np.empty_like(time_s), np.empty_like(time_s)
    edges = np.searchsorted(time_s, grid.time_s[breaks], side="left")
    edges[0], edges[-1] = 0, time_s.size
    for k, (lo, hi) in enumerate(pairwise(breaks.tolist())):
        rows = slice(int(edges[k]), int(edges[k + 1]))
        if rows.stop <= rows.start:
            continue
        x, v = local_polynomial(grid.values[lo : hi + 1], half, grid.step)
        if rows.stop - rows.start == x.size and np.allclose(
            time_s[rows], grid.time_s[lo : hi + 1], atol=1e-3 * grid.step
        ):
            position[rows], velocity[rows] = x, v
            continue
        position[rows], velocity[rows] = hermite(grid.time_s[lo : hi + 1], x, v, time_s[rows])
    return position, velocity


def _degree(window: int) -> int:
    """Windows are chosen with a cubic; a quintic pulls the curve towards mid-stroke by 0.0001 and not by 0.004 mm."""
    return _QUINTIC if window >= 2 * _QUINTIC - 1 else _CUBIC


def local_polynomial(values: FloatArray, half: int, step: float) -> tuple[FloatArray, FloatArray]:
    """Local quintic (cubic where the window is short) through one stretch; its ends use the last whole window.

    Position and velocity, shape (n,), of values `step` s apart; `half` is the half-width of the window, samples.
    """
    n = values.size
    if n < 2:
        return values, np.zeros(n)
    window = min(2 * half + 1, n if n % 2 else n - 1)
    if window <= _CUBIC + 1:
        slope = float(values[-1] - values[0]) / ((n - 1) * step)
        return values, np.full(n, slope)
    return filtered(values, window, _degree(window), step)


def bandwidth(half: int, step: float) -> float:
    """Frequency, Hz, at which the velocity from the local polynomial has lost 3 dB.

    `half` is the half-width of the window, samples, which are `step` s apart.
    """
    window = 2 * half + 1
    kernel = weights(window, _degree(window), 1, step)
    offsets = np.arange(-half, half + 1) * step
    frequency = np.linspace(1e-3, 0.5, 2000) / step
    omega = 2 * np.pi * frequency
    gain = np.abs(np.sin(np.outer(omega, offsets)) @ kernel) / omega
    below = np.flatnonzero(gain < np.sqrt(0.5))
    return float(frequency[below[0]] if below.size else frequency[-1])


SHORTEST, WIDER, PARABOLA = 5, 1.5, 2  # values in the first window, factor to the next one, degree


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


def channel_of(extra: Column, time_s: FloatArray, force_kN: FloatArray) -> Channel:
    """Take the noise off a further channel or say why it cannot serve; times and force are those of its samples."""
    since = time_s - time_s[0]
    known = np.flatnonzero(np.isfinite(extra.values))
    gap = float(np.diff(since[known], prepend=0.0, append=since[-1]).max() / since[-1])
    if known.size < SHORTEST or gap > limits.CHANNEL_GAP:
        return Channel(extra.name, extra.unit or "", np.zeros(0), np.zeros(0), Refusal.GAPS, gap)
    time = since[known]
    step = max(float(np.median(np.diff(time))), since[-1] / limits.CHANNEL_CELLS)
    grid = Samples(time, extra.values[known], 0.0, step).averaged(step)
    smoothed, left = _smoothed(grid.values)
    found = Channel(extra.name, extra.unit or "", grid.time_s, smoothed)
    whole = float(np.var(smoothed))
    noise = min(left / whole, 1.0) if np.ptp(smoothed) > 1e-9 * np.abs(smoothed).max() else 1.0
    if noise > limits.CHANNEL_NOISE:
        return replace(found, refused=Refusal.CONSTANT, share=noise)
    shared = float(np.corrcoef(np.interp(since, grid.time_s, smoothed), force_kN)[0, 1]) ** 2
    return replace(found, refused=Refusal.FOLLOWS_FORCE, share=shared) if shared > limits.CHANNEL_FOLLOWS else found


def _smoothed(values: FloatArray) -> tuple[FloatArray, float]:
    """Smooth evenly spaced values by local parabolas; give them and the variance of the noise that is left in them.

    Their window predicts each value best from its neighbours (leave-one-out: Allen 1974, Technometrics 16, 125).
    """
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

    Values at times `extra_s`, both of shape (m,) and NaN where not known; `time_s` has shape (n_samples,).
    """
    known = np.flatnonzero(np.isfinite(extra_s) & np.isfinite(values))
    known = known[np.argsort(extra_s[known], kind="stable")]
    extra_s, values = extra_s[known], values[known]
    if extra_s.size == 0:
        return np.full(time_s.size, np.nan)
    last = extra_s.size - 1
    after = np.searchsorted(extra_s, time_s)
    to_before = time_s - extra_s[np.maximum(after - 1, 0)]
    to_after = extra_s[np.minimum(after, last)] - time_s
    apart = np.where(after == 0, to_after, np.where(after > last, to_before, to_before + to_after))
    near = (apart <= limits.CHANNEL_GAP * (time_s[-1] - time_s[0])) | (to_after == 0.0)
    return np.where(near, np.interp(time_s, extra_s, values), np.nan)
