"""Mean residual over a coordinate, learnt on one half of the cycles and checked on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lombscargle

from shj_bayes.mismatch.calibrate import Line
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.model.parameters import FloatArray

N_BINS = 96  # at most; a profile of 190 mm shows waves from 6 mm
PER_BIN = 40  # samples in all, so that each half of the cycles has about ten in each direction
MODES = ("friction", "force", "push", "pull")


@dataclass(frozen=True)
class Axis:
    """A coordinate over which a residual may be regular.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        As a reader sees them.
    channel : str
        Array of the histories.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    channel: str


AXES = (
    Axis("position", "x", "mm", "x is the position from mid-stroke", "position_mm"),
    Axis("slip since reversal", "d", "mm", "d is the distance moved since the last reversal", "slip_mm"),
    Axis("travel", "s", "m", "s is the distance travelled since the first sample of the first run", "travel_m"),
    Axis("speed", "v", "mm/s", "v is the speed", "speed_mm_s"),
)


@dataclass(frozen=True, eq=False)
class Profile:
    """Means of a residual over one axis, in push and in pull, in one half of the cycles.

    Parameters
    ----------
    x, mean_kN, count : array, shape (2, n_bins)
        Push, then pull: mean scaled coordinate, mean residual, number of samples; count 0 where there are none.
    """

    x: FloatArray
    mean_kN: FloatArray
    count: FloatArray

    def at(self, side: int, x: FloatArray) -> FloatArray:
        """Mean residual of one direction at other places, by linear interpolation."""
        own = np.flatnonzero(self.count[side])
        if own.size == 0:
            return np.zeros_like(x)
        order = own[np.argsort(self.x[side, own], kind="stable")]
        return np.asarray(np.interp(x, self.x[side, order], self.mean_kN[side, order]))


@dataclass(frozen=True, eq=False)
class Folded:
    """A residual over one axis, cut into the half that is learnt from and the half that is held out.

    Parameters
    ----------
    axis : Axis
        The coordinate.
    scale : float
        What the coordinate was divided by; over time, the period.
    x : array, shape (n,)
        Scaled coordinate of each sample.
    used, learn : array of bool, shape (n,)
        Samples that count; those of them in cycles to learn from.
    half_cycle : array of int, shape (n,)
        Half-cycle of each sample, counted through all runs.
    early, late : Profile
        Of the cycles learnt from, and of the others.
    """

    axis: Axis
    scale: float
    x: FloatArray
    used: NDArray[np.bool_]
    learn: NDArray[np.bool_]
    half_cycle: NDArray[np.int64]
    early: Profile
    late: Profile

    @property
    def repeats(self) -> float:
        """Sum of squares of the held-out samples that comes again from one half of the cycles to the other, kN^2.

        The product of two means with independent noise has no noise in it on average.
        """
        return sum(float(self.repeat_of(side).sum()) for side in (0, 1))

    def repeat_of(self, side: int) -> FloatArray:
        """Contribution of each interval of one direction to `repeats`, kN^2."""
        late = self.late
        return np.asarray(late.count[side] * late.mean_kN[side] * self.early.at(side, late.x[side]))


def signs(mode: str) -> tuple[float, float]:
    """Sign of a formula in push and in pull."""
    return {"friction": (1.0, -1.0), "force": (1.0, 1.0), "push": (1.0, 0.0), "pull": (0.0, 1.0)}[mode]


def half_cycles(evidence: Evidence) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Half-cycle of each sample, counted through all runs, and whether its cycle is one to learn from (every other)."""
    numbers, learn, before = [], [], 0
    for history in evidence.histories:
        own = history.motion.half_cycle
        numbers.append(own + before)
        # The first half-cycle is a quarter of a cycle: it joins the cycle after it, as in the evidence.
        learn.append(np.maximum(own - 1, 0) // 2 % 2 == 0)
        before += int(own[-1]) + 1
    return np.concatenate(numbers).astype(np.int64), np.concatenate(learn)


def fold(evidence: Evidence, residual: FloatArray, axis: Axis) -> Folded:
    """Cut a residual over one axis of `AXES`."""
    values = evidence.stack(axis.channel)
    scale = float(np.max(np.abs(values))) or 1.0
    x = values / scale
    half, learn = half_cycles(evidence)
    # No place of the travel comes again: its intervals are the half-cycles.
    index = half if axis.name == "travel" else _intervals(x, evidence.weight)
    return _folded(axis, scale, x, evidence.weight > 0, (half, learn), index, evidence, residual)


def fold_time(evidence: Evidence, residual: FloatArray, line: Line) -> Folded:
    """Cut a residual over the time within the period of a line, in the run in which the line is strongest."""
    own = (evidence.run == line.run) & (evidence.weight > 0)
    half, learn = half_cycles(evidence)
    time = evidence.stack("time_s")
    known = own & learn
    level = residual[known] - residual[known].mean()
    turns = float(np.ptp(time[own])) / line.period_s
    near = line.period_s / np.linspace(max(1 - 1.5 / turns, 0.3), 1 + 1.5 / turns, 301)
    period = float(near[int(np.argmax(lombscargle(time[known], level, 2 * np.pi / near)))])
    meaning = f"t is the time since the start of run {line.run}"
    x = np.asarray((time % period) / period)
    index = _intervals(x, own.astype(np.float64), 24)
    return _folded(Axis("time", "t", "s", meaning, "time_s"), period, x, own, (half, learn), index, evidence, residual)


def _intervals(x: FloatArray, weight: FloatArray, most: int = N_BINS) -> NDArray[np.int64]:
    n_bins = int(np.clip(np.count_nonzero(weight) // PER_BIN, 12, most))
    edges = np.linspace(float(x.min()), float(x.max()) + 1e-9, n_bins + 1)
    return np.asarray(np.clip(np.searchsorted(edges, x, side="right") - 1, 0, n_bins - 1), dtype=np.int64)


def _folded(
    axis: Axis,
    scale: float,
    x: FloatArray,
    used: NDArray[np.bool_],
    cycles: tuple[NDArray[np.int64], NDArray[np.bool_]],
    index: NDArray[np.int64],
    evidence: Evidence,
    residual: FloatArray,
) -> Folded:
    half, learn = cycles
    sense = evidence.stack("direction")
    halves = [_profile(x, residual, index, sense, used & own) for own in (learn, ~learn)]
    return Folded(axis, scale, x, used, learn & used, half, halves[0], halves[1])


def _profile(
    x: FloatArray, residual: FloatArray, index: NDArray[np.int64], sense: FloatArray, own: NDArray[np.bool_]
) -> Profile:
    """Means over intervals, push and pull."""
    n = int(index.max()) + 1
    rows = []
    for sign in (1.0, -1.0):
        inside = own & (sense == sign)
        count = np.bincount(index[inside], minlength=n).astype(np.float64)
        least = np.maximum(count, 1.0)
        rows.append(
            (
                np.bincount(index[inside], weights=x[inside], minlength=n) / least,
                np.bincount(index[inside], weights=residual[inside], minlength=n) / least,
                count,
            )
        )
    return Profile(*(np.stack([row[i] for row in rows]) for i in range(3)))
