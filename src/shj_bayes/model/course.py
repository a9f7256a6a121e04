"""Motion between the samples, compiled: what a history was at other times than those it was recorded at."""

import numpy as np
from numba import njit

from shj_bayes.model.parameters import FloatArray

# Shares of the speed of the last sample but one of a half-cycle at which samples are added up to its end. Friction that
# rises as the speed falls rises most there, and no faster than the stiffness allows: the force at the turning point
# hangs on the whole way to it. Without them it was off by up to 1.2 kN of 65 at 10 Hz, with the end alone by 1.1.
SLOWING = (0.5, 0.25, 0.125, 0.0625, 0.03125, 0.0)
# Distances from a turning point, of the half stroke, at which samples that thinning leaves out go on being followed.
NEAR_TURNING = (0.0003, 0.001, 0.003, 0.01)
OF_MOTION = ("time_s", "displacement_mm", "speed_mm_s")
ROWS = (*OF_MOTION, "direction", "slip_mm", "travel_m", "amplitude_mm", "acceleration_mm_s2", "rest_s")


def course_of(
    time: FloatArray, displacement: FloatArray, velocity: FloatArray, travel: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Polynomials in the time since each sample, for `fill_between`, shape (n_samples - 1, 9).

    Displacement (mm) follows the cubics through displacement and velocity of the samples on either side, travel (m) and
    acceleration the straight lines.
    """
    step = np.diff(time)
    step = np.where(step > 0.0, step, np.inf)  # two points of one moment have nothing between them
    mean, before, after = np.diff(displacement) / step, velocity[:-1], velocity[1:]
    second, third = (3 * mean - 2 * before - after) / step, (before + after - 2 * mean) / step**2
    rows = [time[:-1], displacement[:-1], before, second, third]
    for channel in (travel, acceleration):
        rows += [channel[:-1], np.diff(channel) / step]
    return np.ascontiguousarray(np.stack(rows, axis=1))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_between(out, own, time, lag, start, of_half, course, way):  # type: ignore[no-untyped-def]
    """Fill the rows of `out`, in the order of `ROWS`, with what was `lag` before each time, and `own` with where it is.

    In between come the samples of `way`: their rows, and where they begin in each half-cycle. Before the first sample
    and after the last everything stands at what it was there. `start` is where in `time` each half-cycle has come;
    `of_half` holds direction, turning point, amplitude and rest of each.
    """
    direction, turning, amplitude, rest = of_half
    rows, begins = way
    i, last, m = 0, course.shape[0] - 1, 0
    for half in range(direction.size):
        sense, origin, w = float(direction[half]), turning[half], begins[half]
        until = rows[0, w] + lag if w < begins[half + 1] else np.inf
        for k in range(start[half], start[half + 1] + 1):
            ends = k == start[half + 1]
            while w < begins[half + 1] and (ends or until <= time[k]):
                out[:, m] = rows[:, w]
                out[0, m] = until
                m, w = m + 1, w + 1
                until = rows[0, w] + lag if w < begins[half + 1] else np.inf
            if ends:
                break
            then = min(max(time[k] - lag, time[0]), time[-1])
            while i < last and course[i + 1, 0] <= then:
                i += 1
            p = course[i]
            s = then - p[0]
            x = p[1] + s * (p[2] + s * (p[3] + s * p[4]))
            # The first half-cycle may begin with a rest on either side of its origin.
            x = origin if half > 0 and lag != 0.0 and sense * (x - origin) < 0.0 else x
            out[0, m] = time[k]
            out[1, m] = x
            out[2, m] = max(sense * (p[2] + s * (2.0 * p[3] + s * 3.0 * p[4])), 0.0)
            out[3, m] = sense
            out[4, m] = abs(x - origin)
            out[5, m] = p[5] + s * p[6]
            out[6, m] = amplitude[half]
            out[7, m] = p[7] + s * p[8]
            out[8, m] = rest[half]
            own[k] = m
            m += 1
