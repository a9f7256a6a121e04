"""Runs of a device as evidence, and their averages: many blocks where the force bends, few where it is straight.

A block holds neighbouring samples of one half-cycle. It ends where its time, its slip or the bend of the modelled force
within it has grown to a limit, so that the number of blocks does not grow with the sampling rate. The force of a block
is the mean of the model at two points that have the mean and the variance of its samples in every channel (for a force
that is a cubic of the displacement this is exact for evenly spread samples); a block of one sample has one.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.errors import InferenceError
from shj_bayes.model.device import UNLOADED, DeviceModel
from shj_bayes.model.filter import Timing
from shj_bayes.model.history import History, Measured, histories, measured_in, thinned
from shj_bayes.recording.motion import NEAR, Motion, degree_for, motion_of
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.smoothing import Channel, Refusal, channel_of

MOVED = 2e-3  # of the largest stroke: more than noise
LOADED = 0.3  # likewise: how far a first loading is followed as a straight line
Force = Callable[[History, float], FloatArray]
PER_STROKE = 64.0  # blocks that a whole stroke is divided into at least
# Standard deviation of the load cell's zero, of the largest force: testing machines of class 1 may be off by 0.1 % of
# their range (ISO 7500-1, Table 2), and a rig's range is several times what a connection takes.
ZERO = 0.005
LONGEST_S, LEAST_BLOCKS = 0.25, 3000  # a block lasts no longer than this, or than this part of the run
PER_BEND = 24.0  # blocks at least that the bends of a typical half-cycle are divided into
FIRST_LOOK = 400.0  # blocks to a stroke where the bend is not known yet
FINEST = 2000.0  # points to a stroke at which the bend is looked for
APART = 3.0  # standard deviations of the displacement's noise between points that tell of the slope of the force
SAME = 64.0  # spacings that differ by less than 1/64 in the binary logarithm count as equal
# Variance of a polynomial's value in the middle of n points, times n, by its degree (Savitzky and Golay 1964):
# reversals are placed so.
OF_DEGREE = {4: 225.0 / 64.0, 6: 1225.0 / 256.0}


@dataclass(frozen=True, eq=False)
class Run:
    """One run as evidence."""

    recording: Recording  # the measured channels
    motion: Motion  # half-cycles, turning points and speed of its displacement
    begins_kN: float | None = None  # force with which the law starts, where a fit has found it; else it is read

    def __post_init__(self) -> None:
        """Refuse a motion that belongs to another recording."""
        if self.motion.displacement_mm.size != self.recording.n_samples:
            raise InferenceError(
                f"{self.recording.source.name}: motion has {self.motion.displacement_mm.size} samples, "
                f"the recording {self.recording.n_samples}"
            )

    @cached_property
    def used(self) -> BoolArray:
        """Samples that are evidence: neither repaired nor so near a reversal that their side of it is not known."""
        used, unsure = self.recording.used, self.motion.unsure
        assert used is not None
        assert unsure is not None
        return np.asarray(used & ~unsure)

    @cached_property
    def start_force_kN(self) -> float:
        """Force with which the law starts: 0 for an unloaded device, else what was measured before it moves.

        A device at rest counts as unloaded when that is within the noise. A recording that begins in motion
        has the force of its first displacement, on a straight line through its first loading, until a fit has found it.
        """
        if self.begins_kN is not None:
            return self.begins_kN
        force, x = self.recording.force_kN, self.motion.displacement_mm
        if self._in_motion and self._n_loading > 2:
            some = slice(self._n_loading)
            line = np.polynomial.Polynomial.fit(x[some], force[some], 1)
            return float(line(self.motion.turning_mm[0]))
        first = float(np.median(force[: self._n_rest]))
        noise = 1.4826 * float(np.median(np.abs(np.diff(force))))
        return first if abs(first) > 6 * noise else 0.0

    @cached_property
    def start_noise_mm(self) -> float:
        """Standard deviation of the displacement at which the first half-cycle begins, mm.

        For a device that rests unloaded that of a single reading. Of a recording that begins loaded or in motion the
        force without the part that comes from the speed is not known: by `start_noise_kN`, at the stiffness of its
        first loading.
        """
        force, x, i = self.recording.force_kN, self.motion.displacement_mm, self._n_loading
        if not self.start_noise_kN or i == force.size:
            return self.motion.noise_mm
        return self.start_noise_kN * abs(float(x[i] - x[0])) / abs(float(force[i] - force[0]))

    @cached_property
    def start_noise_kN(self) -> float:
        """Standard deviation of the force with which the law starts, where it does not rest unloaded; else 0.

        The force that is read holds that of the speed, and a constant that is none of the device.
        """
        return UNLOADED * self._largest_kN if self._in_motion or self.start_force_kN else 0.0

    @cached_property
    def _largest_kN(self) -> float:
        """Largest measured force, kN."""
        return float(np.abs(self.recording.force_kN[self.used]).max())

    @cached_property
    def _n_loading(self) -> int:
        """Samples before the force has changed by `LOADED`; all where it never does."""
        force = self.recording.force_kN
        loaded = np.abs(force - force[0]) > LOADED * self._largest_kN
        return int(np.argmax(loaded)) if loaded.any() else int(force.size)

    @cached_property
    def _n_rest(self) -> int:
        """Samples before the device has moved by more than noise, at least one."""
        x = self.motion.displacement_mm
        return max(1, int(np.argmax(np.abs(x - x[0]) > MOVED * np.ptp(x))))

    @cached_property
    def _in_motion(self) -> bool:
        """Whether the recording begins in motion: in half the time it has gone half the way, not a quarter of it."""
        x, n_rest = self.motion.displacement_mm, self._n_rest
        return n_rest <= 2 or bool(abs(x[n_rest // 2] - x[0]) > 0.375 * MOVED * np.ptp(x))

    @cached_property
    def further(self) -> tuple[Channel, ...]:
        """Further channels without their noise."""
        r = self.recording
        return tuple(channel_of(extra, r.time_s, r.force_kN) for extra in r.extras)


def runs_of(recordings: Sequence[Recording]) -> tuple[Run, ...]:
    """Consecutive runs of a device, with their motion."""
    return tuple(Run(recording, motion_of(recording)) for recording in recordings)


def histories_of(runs: Sequence[Run]) -> tuple[History, ...]:
    """Histories of the runs of one device, at all samples."""
    times = [run.recording.time_s for run in runs]
    return histories(times, [run.motion for run in runs], measured_of(runs))


def measured_of(runs: Sequence[Run]) -> tuple[Mapping[str, Measured], ...]:
    """Further channels of each run that a force may depend on, by their coordinates."""
    serves = {one.name for one in further_of(runs) if one.refused is None}
    return measured_in([[one for one in run.further if one.name in serves] for run in runs])


def further_of(runs: Sequence[Run]) -> tuple[Channel, ...]:
    """Give every further channel once, with what keeps it from serving in any of the runs.

    That it is constant in some of them does not: it may differ from run to run.
    """
    out = []
    for name in dict.fromkeys(one.name for run in runs for one in run.further):
        own = [one for run in runs for one in run.further if one.name == name]
        refused = [one for one in own if one.refused not in (None, Refusal.CONSTANT)]
        steady = all(one.refused is Refusal.CONSTANT for one in own)
        if len(own) < len(runs):
            out.append(replace(own[0], refused=Refusal.MISSING, share=1.0 - len(own) / len(runs)))
        else:
            out.append(refused[0] if refused else own[0] if steady else replace(own[0], refused=None, share=0.0))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class BinnedRun:
    """One run in blocks."""

    history: History  # at the points of all blocks
    first: IntArray  # shape (n + 1,): block i has the points ``first[i]:first[i+1]``, one or two
    force_kN: FloatArray  # shape (n,): measured force, mean of each block
    count: FloatArray  # shape (n,): samples in each block; 0 for one that only keeps a half-cycle from being empty
    timing: Timing  # when the blocks were taken
    run: Run  # what they are blocks of

    @property
    def n(self) -> int:
        """Number of blocks."""
        return int(self.force_kN.size)

    def mean(self, values: FloatArray) -> FloatArray:
        """Mean over each block, shape (n,), of values at the points, shape (n_points,)."""
        return np.asarray(np.add.reduceat(values, self.first[:-1]) / np.diff(self.first))

    def force(self, model: DeviceModel, theta: FloatArray) -> FloatArray:
        """Modelled force at the points for parameter sets in natural units, shape (m, d) to (m, n_points), kN."""
        return model.force(theta, self.history, self.run.start_force_kN)

    def residual_and_slope(self, force_kN: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force of each block, kN (0 without samples), and its slope, kN/mm, shape (m, n).

        `force_kN`, shape (m, n_points), is the modelled force at the points.
        """
        motion = self.history.motion
        residual, slope = np.empty((force_kN.shape[0], self.n)), np.empty((force_kN.shape[0], self.n))
        _gather(residual, slope, force_kN, motion.displacement_mm, self.first, self.ends, self.force_kN, self.count)
        return residual, slope

    @cached_property
    def ends(self) -> IntArray:
        """Points between which the slope of the force in each block is taken, shape (n, 2).

        They lie in its half-cycle and farther apart than noise: in a rest the force changes with time, not with that.
        """
        motion, out = self.history.motion, np.empty((self.n, 2), dtype=np.int64)
        _between(out, motion.displacement_mm, self.first, motion.start, APART * self.timing.displacement_noise_mm)
        return out


class Blocks(tuple[BinnedRun, ...]):
    """Consecutive runs of a device in blocks; arrays hold those of all runs, one behind the other."""

    @cached_property
    def n_samples(self) -> FloatArray:
        """Samples that each block is the mean of, shape (n,); 0 where it is no evidence."""
        return np.concatenate([part.count for part in self])

    @cached_property
    def used(self) -> FloatArray:
        """1 for blocks that are evidence, 0 for the others, shape (n,)."""
        return (self.n_samples > 0).astype(np.float64)

    @cached_property
    def force_kN(self) -> FloatArray:
        """Measured force, shape (n,), kN."""
        return np.concatenate([part.force_kN for part in self])

    def mean(self, values: Sequence[FloatArray]) -> FloatArray:
        """Means of functions at the points of each run, shapes (n_points, ...) to (n, ...); 0 without evidence."""
        out = []
        for part, own in zip(self, values, strict=True):
            residual, _ = part.residual_and_slope(np.ascontiguousarray(np.atleast_2d(own.T)))
            out.append(np.where(part.count > 0, part.force_kN - residual, 0.0).T)
        means = np.concatenate(out)
        return means if values[0].ndim > 1 else means[:, 0]

    def channel(self, name: str) -> FloatArray:
        """Channel of the histories, shape (n,)."""
        return self.mean([getattr(part.history, name) for part in self])


def reduce_runs(
    runs: Sequence[Run], force_at: Force | None = None, *, longest_s: float | None = None, coarser: float = 1.0
) -> Blocks:
    """Average the runs of a device.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    force_at : callable, optional
        ``force_at(history, start_force_kN)`` gives the force (kN) at the points of a history in a model that is near
        the data: it tells where the force bends. Without it the blocks are of even and small slip, for a first look.
    longest_s : float, optional
        Longest block, s; 0 makes each sample a block of its own, which is no reduction at all. By default `LONGEST_S`,
        or what divides the run into `LEAST_BLOCKS` where that is more.
    coarser : float
        By how much the blocks are longer than that, in time, slip and bend: for comparing many models.
    """
    whole = histories_of(runs)
    bends = [None] * len(runs) if force_at is None else _bends(runs, whole, force_at)
    parts = zip(runs, whole, bends, strict=True)
    zero_kN = zero_noise_kN(runs[0].recording.force_kN[runs[0].used])
    return Blocks(_reduce(run, history, bend, longest_s, coarser, zero_kN) for run, history, bend in parts)


def zero_noise_kN(force_kN: FloatArray) -> float:
    """Give the standard deviation of the load cell's zero before a test with given forces, kN."""
    return ZERO * float(np.percentile(np.abs(force_kN), 99))


def _bends(runs: Sequence[Run], whole: Sequence[History], force_at: Force) -> list[FloatArray]:
    """How far each sample lies along the bends of the force, in blocks, from the beginning of its half-cycle."""
    raw, totals = [], []
    for run, history in zip(runs, whole, strict=True):
        x, start = run.motion.displacement_mm, run.motion.start
        keep = np.empty(x.size, dtype=np.int64)
        keep = keep[: _spaced(keep, x, run.motion.turning_mm, start, float(np.ptp(x)) / FINEST)]
        fewer = thinned(history, keep)
        force, place = force_at(fewer, run.start_force_kN), fewer.motion.start
        along = np.empty(keep.size)
        _bend_along(along, force, x[keep], place)
        totals.append(along[place[1:] - 1])
        before = np.concatenate([[0.0], np.cumsum(totals[-1])[:-1]])  # bends of all half-cycles before each one
        raw.append(np.interp(np.arange(x.size), keep, along + np.repeat(before, np.diff(place))))
    typical = float(np.median(np.concatenate(totals)))
    return [at * (PER_BEND / typical) if typical > 0.0 else np.zeros_like(at) for at in raw]


def _reduce(
    run: Run, history: History, bend: FloatArray | None, longest_s: float | None, coarser: float, zero_kN: float
) -> BinnedRun:
    """Average one run."""
    recording, motion = run.recording, run.motion
    time, x = recording.time_s, motion.displacement_mm
    stroke, n_half = float(np.ptp(x)), motion.n_half
    longest = max(LONGEST_S, recording.duration_s / LEAST_BLOCKS) if longest_s is None else longest_s
    longest, slip = longest * coarser, coarser * stroke / (FIRST_LOOK if bend is None else PER_STROKE)
    flat = np.zeros(time.size) if bend is None else bend / coarser
    block = np.empty(time.size, dtype=np.int64)
    n = _cut(block, run.used, recording.restarts, motion.start, time, x, flat, longest, slip)
    order = np.flatnonzero(block >= 0)
    of = block[order]
    begin = np.searchsorted(of, np.arange(n))
    count = np.where(run.used[order[begin]], np.diff(np.append(begin, of.size)), 0).astype(np.float64)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values[order], begin) / np.maximum(count, 1.0))

    rows = history.rows
    centre = np.stack([mean(row) for row in rows])
    away = x[order] - centre[1][of]
    spread = np.sqrt(np.add.reduceat(away**2, begin) / np.maximum(count, 1.0))
    double = (count > 1) & (spread > 1e-9 * stroke)
    lean = np.stack([np.add.reduceat(away * (row[order] - c[of]), begin) for row, c in zip(rows, centre, strict=True)])
    lean = np.where(double, lean / np.maximum(count * spread, 1e-300), 0.0)
    half = motion.half_cycle[order[begin]]
    sense = motion.direction[half]
    first = np.concatenate([[0], np.cumsum(1 + double)])
    of_point = np.repeat(np.arange(n), 1 + double)
    later = np.zeros(of_point.size, dtype=np.bool_)
    later[first[1:] - 1] = double
    # In the order of time, which in a rest is not that of the slip.
    ahead = np.where(lean[0] == 0.0, sense, np.sign(lean[0]))
    sign = np.where(double[of_point], np.where(later, 1.0, -1.0) * ahead[of_point], 0.0)
    points = centre[:, of_point] + sign * lean[:, of_point]
    points[2] = np.maximum(points[2], 0.0)
    reduced = history.reduced(points, np.searchsorted(half[of_point], np.arange(n_half + 1)))
    timing = _timing(run, order, begin, count, np.searchsorted(half, np.arange(n_half + 1)), zero_kN)
    force = np.where(count > 0, mean(recording.force_kN), 0.0)
    return BinnedRun(reduced, first, force, count, timing, run)


def _timing(run: Run, order: IntArray, begin: IntArray, count: FloatArray, half: IntArray, zero_kN: float) -> Timing:
    """When the blocks were taken; equal spacings share a kind."""
    time, restarts = run.recording.time_s, run.recording.restarts
    step = 1.0 / run.recording.rate_Hz
    first = order[begin]
    last = order[np.append(begin[1:], order.size) - 1]
    within = np.where(count > 1, (time[last] - time[first]) / np.maximum(count - 1, 1), step)
    own = np.flatnonzero(count > 0)
    gap = np.full(first.size, np.inf)
    gap[own[1:]] = time[first[own[1:]]] - time[last[own[:-1]]]
    # A restart between two blocks, or at the first sample of a block, forgets what was before.
    passed = np.cumsum(restarts)
    gap[own[1:]] = np.where(passed[first[own[1:]]] > passed[last[own[:-1]]], np.inf, gap[own[1:]])

    def rounded(seconds: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(step * np.exp2(np.rint(SAME * np.log2(seconds / step)) / SAME))

    table = np.stack([count[own], rounded(within[own]), rounded(gap[own])], axis=1)
    kinds, place = np.unique(table, axis=0, return_inverse=True)
    kind = np.full(first.size, -1, dtype=np.int64)
    kind[own] = place.ravel()
    return Timing(kind, kinds, half, step, run.motion.noise_mm, _turning_noise(run), zero_kN)


def _turning_noise(run: Run) -> FloatArray:
    """Give the standard deviation of each turning point's error, mm: of a polynomial through the samples near it.

    The first half-cycle begins without a turn, where the recording does.
    """
    motion = run.motion
    x, edges, stroke = motion.displacement_mm, motion.start, motion.stroke_mm
    out = np.zeros(motion.n_half)
    out[0] = run.start_noise_mm
    for k in range(1, motion.n_half):
        reach = NEAR * min(stroke[k - 1], stroke[k])
        near = np.abs(x[edges[k - 1] : edges[k + 1]] - motion.turning_mm[k]) <= reach
        n = max(int(np.count_nonzero(near)), 1)
        out[k] = motion.noise_mm * min(1.0, float(np.sqrt(OF_DEGREE[degree_for(n)] / n)))
    return out


@njit(cache=True, error_model="numpy")
def _cut(block, used, restarts, start, time, x, bend, longest, slip):  # type: ignore[no-untyped-def]
    """Give each sample the number of its block, -1 for none; a half-cycle without evidence keeps its first sample."""
    n = 0
    for k in range(start.size - 1):
        begin, some = -1, False
        for i in range(start[k], start[k + 1]):
            if not used[i]:
                block[i] = -1
                begin = -1
                continue
            over = begin >= 0 and (
                restarts[i]
                or time[i] - time[begin] > longest
                or abs(x[i] - x[begin]) > slip
                or bend[i] - bend[begin] > 1.0
            )
            if begin < 0 or over:
                begin = i
                n += 1
            block[i] = n - 1
            some = True
        if not some:
            block[start[k]] = n
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def _spaced(keep, x, turning, start, least):  # type: ignore[no-untyped-def]
    """Fill `keep` with the first sample of each half-cycle and those `least` of slip behind the last; count them."""
    n = 0
    for k in range(turning.size):
        keep[n] = start[k]
        n += 1
        reached = abs(x[start[k]] - turning[k])
        for i in range(start[k] + 1, start[k + 1]):
            slip = abs(x[i] - turning[k])
            if slip - reached >= least:
                keep[n] = i
                n += 1
                reached = slip
    return n


@njit(cache=True, error_model="numpy")
def _bend_along(along, force, x, start):  # type: ignore[no-untyped-def]
    """Fill `along` with the integral of sqrt |F''| over the slip of each half-cycle."""
    for k in range(start.size - 1):
        a, b = start[k], start[k + 1]
        along[a] = 0.0
        for i in range(a + 1, b):
            j = min(max(i, a + 2), b - 1)  # the first step bends as the second does
            bend = 0.0
            if j - a >= 2:
                here, last = x[j] - x[j - 1], x[j - 1] - x[j - 2]
                change = (force[j] - force[j - 1]) / here - (force[j - 1] - force[j - 2]) / last
                bend = math.sqrt(abs(change) * abs(here))
            along[i] = along[i - 1] + bend


@njit(cache=True, error_model="numpy")
def _between(ends, x, first, start, least):  # type: ignore[no-untyped-def]
    """Fill `ends` with the points of each block, or with those around it that lie farther apart than `least`."""
    k = 0
    for i in range(first.size - 1):
        a, b = first[i], first[i + 1]
        while a >= start[k + 1]:
            k += 1
        low, high = a, b - 1
        begin, end = start[k], start[k + 1] - 1
        while abs(x[high] - x[low]) <= least and (low > begin or high < end):
            low, high = max(low - 1, begin), min(high + 1, end)
        ends[i, 0], ends[i, 1] = low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(residual, slope, force, x, first, ends, measured, count):  # type: ignore[no-untyped-def]
    """Means over the points of each block, and the slope of the force between its `ends`."""
    for j in range(force.shape[0]):
        f = force[j]
        for i in range(first.size - 1):
            a = first[i]
            residual[j, i] = measured[i] - (0.5 * (f[a] + f[a + 1]) if first[i + 1] - a == 2 else f[a])
            low, high = ends[i]
            moved = x[high] - x[low]
            slope[j, i] = (f[high] - f[low]) / moved if moved != 0.0 else 0.0
            if count[i] == 0.0:
                residual[j, i] = 0.0
