"""A shape in a residual that comes again from one half-cycle to the next in the same direction.

A misfit that is spread over the whole stroke in waves, or that changes from cycle to cycle as a place wears, has no
region of its own and may go along with no effect of the catalogue. But its shape comes again, and noise does not: the
product of the means of two half-cycles over the same interval has no noise in it on average. It also says how much
of the repeating misfit of the base law the effects take up, without any guess of the noise floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.profiles import half_cycles
from shj_bayes.model.parameters import FloatArray

N_BINS = 32
N_FLIPS = 4999
NEAR = 0.01  # of the half stroke: slips below it share the first interval, as the knee is steep there
EXTREME = 2.576  # standard deviations that 1 % of a normal law exceeds: sizes are 99th percentiles everywhere
COORDINATES = ("position", "slip since reversal", "speed")


@dataclass(frozen=True)
class Repeat:
    """What comes again in a residual.

    Parameters
    ----------
    p_value : float
        Of "nothing comes again", corrected for the coordinates.
    coordinate : str
        Over which most comes again.
    rms_kN : float
        Root mean square of what comes again over it, 0 where chance made the estimate negative, kN.
    """

    p_value: float
    coordinate: str
    rms_kN: float

    @property
    def size_kN(self) -> float:
        """As large as 1 % of the samples of a normal law with this root mean square, kN."""
        return EXTREME * self.rms_kN


def repeats(evidence: Evidence, residual: FloatArray, rng: np.random.Generator) -> Repeat:
    """Compare each half-cycle with the next one in the same direction.

    Under "nothing is missing" the residuals of two half-cycles are independent and symmetric around 0, so flipping the
    sign of whole half-cycles at random gives what chance does to the sum of their products, whatever the noise is like
    inside a half-cycle. The mean of each half-cycle is taken out first: slow drift comes again too.

    Parameters
    ----------
    evidence : Evidence
        Gives the coordinates and the half-cycles.
    residual : array, shape (n,)
        Of a fitted model, kN.
    rng : numpy.random.Generator
        Source of the flips.

    Returns
    -------
    Repeat
    """
    half, _ = half_cycles(evidence)
    run_of_half = evidence.run[np.flatnonzero(np.diff(half, prepend=-1))]
    together = run_of_half[2:] == run_of_half[:-2]
    slip = np.maximum(evidence.stack("slip_mm"), 0.0) / (NEAR * evidence.histories[0].half_stroke_mm)
    values = (evidence.stack("position_mm"), np.log1p(slip), evidence.stack("speed_mm_s"))
    products, counts = [], []
    for value in values:
        mean, count = _means(value, residual, half, evidence.weight > 0)
        both = np.minimum(count[2:], count[:-2]) * together[:, None]
        products.append(np.sum(mean[2:] * mean[:-2] * both, axis=1))
        counts.append(max(float(both.sum()), 1.0))
    rows = np.stack(products)
    spread = np.maximum(np.sqrt(np.sum(rows**2, axis=1)), 1e-300)
    flips = rng.choice([-1.0, 1.0], size=(N_FLIPS, half[-1] + 1))
    chance = np.max((flips[:, 2:] * flips[:, :-2]) @ rows.T / spread, axis=1)
    highest = float(np.max(rows.sum(axis=1) / spread))
    variance = rows.sum(axis=1) / np.array(counts)
    most = int(np.argmax(variance))
    return Repeat(
        p_value=float((1 + np.count_nonzero(chance >= highest)) / (N_FLIPS + 1)),
        coordinate=COORDINATES[most],
        rms_kN=float(np.sqrt(max(variance[most], 0.0))),
    )


def repeating_share(before: Repeat, after: Repeat) -> float:
    """Share of what comes again in the residual of one model that a larger model takes up, 0 to 1."""
    return max(0.0, 1.0 - after.rms_kN**2 / max(before.rms_kN**2, 1e-300))


def _means(
    value: FloatArray, residual: FloatArray, half: NDArray[np.int64], own: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Mean residual of each half-cycle in each interval, less that of the half-cycle; and the number of samples."""
    low, high = float(value[own].min()), float(value[own].max())
    place = ((value - low) / max(high - low, 1e-300) * N_BINS).astype(np.int64)
    index = half[own] * N_BINS + np.clip(place[own], 0, N_BINS - 1)
    shape = (int(half[-1]) + 1, N_BINS)
    count = np.bincount(index, minlength=shape[0] * N_BINS).reshape(shape).astype(np.float64)
    total = np.bincount(index, weights=residual[own], minlength=shape[0] * N_BINS).reshape(shape)
    level = total.sum(axis=1) / np.maximum(count.sum(axis=1), 1.0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1.0) - level[:, None], 0.0)), count
