"""Motion between the samples, compiled: what a history was at other times than those it was recorded at."""

from __future__ import annotations

import numpy as np
from numba import njit

from shj_bayes.model.parameters import FloatArray


def course_of(
    time: FloatArray, displacement: FloatArray, velocity: FloatArray, travel: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Polynomials in the time since each sample, for `fill_between`, shape (n_samples - 1, 9).

    Displacement follows the cubics through displacement and velocity of the samples on either side, travel and
    acceleration the straight lines.

    Parameters
    ----------
    time, displacement, velocity, travel, acceleration : array, shape (n_samples,)
        In s, mm, mm/s, m, mm/s^2.
    """
    step = np.diff(time)
    mean, before, after = np.diff(displacement) / step, velocity[:-1], velocity[1:]
    second, third = (3 * mean - 2 * before - after) / step, (before + after - 2 * mean) / step**2
    rows = [time[:-1], displacement[:-1], before, second, third]
    for channel in (travel, acceleration):
        rows += [channel[:-1], np.diff(channel) / step]
    return np.ascontiguousarray(np.stack(rows, axis=1))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_between(out, then, end, start, of_half, course):  # type: ignore[no-untyped-def]
    """Fill the rows of `out` with what was at rising times `then`.

    Rows: displacement, speed, direction, slip, travel, amplitude, acceleration, rest. Before the first sample and after
    the last, at `end`, everything stands at what it was there. `start` is where the half-cycles begin in `then`;
    `of_half` holds direction, turning point, amplitude and rest of each.
    """
    direction, turning, amplitude, rest = of_half
    i, last = 0, course.shape[0] - 1
    for half in range(direction.size):
        sense, origin = float(direction[half]), turning[half]
        for k in range(start[half], start[half + 1]):
            t = min(max(then[k], course[0, 0]), end)
            while i < last and course[i + 1, 0] <= t:
                i += 1
            p = course[i]
            s = t - p[0]
            slip = sense * (p[1] + s * (p[2] + s * (p[3] + s * p[4])) - origin)
            if half > 0:  # the first half-cycle may begin with a rest on either side of its origin
                slip = max(slip, 0.0)
            out[0, k] = origin + sense * slip
            out[1, k] = max(sense * (p[2] + s * (2.0 * p[3] + s * 3.0 * p[4])), 0.0)
            out[2, k] = sense
            out[3, k] = abs(slip)
            out[4, k] = p[5] + s * p[6]
            out[5, k] = amplitude[half]
            out[6, k] = p[7] + s * p[8]
            out[7, k] = rest[half]
