"""What the law needs to know of the displacement: half-cycles, turning points and speed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shj_bayes._util.arrays import freeze, frozen
from shj_bayes.errors import RecordingError
from shj_bayes.recording.recording import BoolArray, FloatArray

IntArray = NDArray[np.int64]


def alternating(n: int, first: int = 1) -> IntArray:
    """Directions of half-cycles, one after the other, shape (n,): `first`, 1 or -1, then to and fro."""
    return np.where(np.arange(n) % 2 == 0, first, -first)


@dataclass(frozen=True, eq=False)
class Motion:
    """The displacement history that drives the law."""

    # shape (n_samples,): displacement, smoothed with the stated method where it was measured
    displacement_mm: FloatArray
    speed_mm_s: FloatArray  # shape (n_samples,): speed, the absolute value of v, never negative
    # shape (n_half + 1,): half-cycle k holds the samples ``start[k]:start[k+1]``; ``start[0] = 0``, ``start[-1] =
    # n_samples``
    start: IntArray
    # shape (n_half,): displacement at which half-cycle k starts: the first sample's for k = 0, else the reversal's
    # (x_reset)
    turning_mm: FloatArray
    direction: IntArray  # shape (n_half,): +1 where displacement grows in the half-cycle, -1 where it falls
    # shape (n_samples,): samples so near a reversal that the noise hides on which side they lie; no evidence for the
    # law
    unsure: BoolArray | None = None
    # how reversals and speed were found, with the bandwidth in Hz; ``"exact"`` for simulated motion
    method: str = "exact"
    noise_mm: float = 0.0  # estimated displacement noise (standard deviation), mm

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        freeze(self, "displacement_mm", "speed_mm_s", "turning_mm")
        freeze(self, "start", "direction", kind=np.int64)
        n = self.displacement_mm.size
        unsure = frozen(np.zeros(n) if self.unsure is None else self.unsure, np.bool_)
        if unsure.shape != (n,):
            raise RecordingError(f"unsure has shape {unsure.shape}; it needs ({n},)")
        object.__setattr__(self, "unsure", unsure)
        n_half = self.turning_mm.size
        if self.speed_mm_s.shape != (n,) or np.any(self.speed_mm_s < 0):
            raise RecordingError("speed_mm_s needs one value, zero or more, for each sample")
        if self.start.shape != (n_half + 1,) or self.start[0] != 0 or self.start[-1] != n:
            raise RecordingError(f"start needs {n_half + 1} indices from 0 to {n}; got {self.start.tolist()[:5]}...")
        if np.any(np.diff(self.start) <= 0) or self.direction.shape != (n_half,):
            raise RecordingError("every half-cycle needs at least one sample and one direction")
        if np.any(np.abs(self.direction) != 1) or np.any(self.direction[1:] == self.direction[:-1]):
            raise RecordingError("directions are +1 or -1 and alternate from one half-cycle to the next")

    @property
    def n_half(self) -> int:
        """Number of half-cycles."""
        return int(self.turning_mm.size)

    @property
    def half_cycle(self) -> IntArray:
        """Index of the half-cycle of each sample, shape (n_samples,)."""
        return np.repeat(np.arange(self.n_half), np.diff(self.start))

    @property
    def stroke_mm(self) -> FloatArray:
        """Distance from where each half-cycle starts to where the next does, or to the end, shape (n_half,), mm."""
        return np.abs(np.diff(self.turning_mm, append=self.displacement_mm[-1]))

    @property
    def travel_mm(self) -> FloatArray:
        """Cumulative distance moved, from turning point to turning point, shape (n_samples,), mm."""
        within = np.abs(self.displacement_mm - self.turning_mm[self.half_cycle])
        return np.asarray(within + np.append(0.0, np.cumsum(self.stroke_mm[:-1]))[self.half_cycle], dtype=np.float64)
