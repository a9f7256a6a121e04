"""Mean residual over the stroke, beside what noise alone would give. Numbers only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.data import BoolArray, IntArray, RunData

N_STROKE = 20
N_SHIFTS = 3  # enough for a band


@dataclass(frozen=True, eq=False)
class StrokeProfile:
    """Mean residual over stroke of one run and direction, arrays of shape (n_bins,).

    Parameters
    ----------
    run, direction : int
        Number of the run; +1 push, -1 pull.
    centre_mm, mean_kN : array
        Middle of the bin and mean residual there.
    low_kN, high_kN : array
        5 and 95 % of what noise alone would give.
    """

    run: int
    direction: int
    centre_mm: FloatArray = field(repr=False)
    mean_kN: FloatArray = field(repr=False)
    low_kN: FloatArray = field(repr=False)
    high_kN: FloatArray = field(repr=False)


def residual(run: RunData) -> FloatArray:
    """Measured force less the posterior mean of the law, kN, shape (n,)."""
    return np.asarray(run.force_kN - run.law_kN.mean(axis=0), dtype=np.float64)


def counted(run: RunData) -> BoolArray:
    """Mark the samples that count: evidence, and not within two samples of a reversal.

    There the published law jumps, and a reversal placed one sample off leaves a residual that is neither noise nor
    physics.
    """
    keep = run.used.copy()
    for shift in (-2, -1, 0, 1):
        at = run.reversals + shift
        keep[at[(at >= 0) & (at < keep.size)]] = False
    return keep


def stroke_profiles(run: RunData, n_bins: int = N_STROKE) -> tuple[StrokeProfile, StrokeProfile]:
    """Mean residual over stroke for push and pull, beside what noise alone would give."""
    x, direction = run.displacement_mm, run.direction
    edges, index = _stroke_bins(x, n_bins)
    out = []
    for sign in (1, -1):
        label = np.where(counted(run) & (direction == sign), index, -1)
        weights, present = means(label)
        low, high = np.quantile(noise_means(run, weights), (0.05, 0.95), axis=1)
        centre = 0.5 * (edges[:-1] + edges[1:])[present]
        out.append(StrokeProfile(run.number, sign, centre, weights @ residual(run), low, high))
    return out[0], out[1]


def noise_means(run: RunData, weights: sparse.csr_array, n_shifts: int = N_SHIFTS) -> FloatArray:
    """Binned means of noise alone, from the posterior predictive.

    Parameters
    ----------
    run : RunData
    weights : sparse array, shape (n_bins, n)
        As `means` gives it.
    n_shifts : int
        The fitted noise is stationary, so each draw may be moved in time to give several.

    Returns
    -------
    array, shape (n_bins, m n_shifts)
    """
    noise = run.predicted_kN - run.law_kN
    steps = np.linspace(0, noise.shape[1], n_shifts, endpoint=False).astype(int)
    # One shift after the other: all at once would take gigabytes for a long recording.
    return np.concatenate([weights @ np.roll(noise, step, axis=1).T for step in steps], axis=1)


def _stroke_bins(x: FloatArray, n_bins: int) -> tuple[FloatArray, IntArray]:
    """Edges of even bins over the stroke, mm, and the bin of each sample."""
    edges = np.linspace(float(x.min()), float(x.max()), n_bins + 1)
    return edges, np.clip(np.digitize(x, edges) - 1, 0, n_bins - 1).astype(np.int64)


def means(label: IntArray) -> tuple[sparse.csr_array, IntArray]:
    """Matrix that takes the mean over the samples of each label (those of -1 left out), and the labels present."""
    inside = np.flatnonzero(label >= 0)
    present, row, count = np.unique(label[inside], return_inverse=True, return_counts=True)
    return sparse.csr_array((1.0 / count[row], (row, inside)), shape=(present.size, label.size)), present
