"""Mean residual over the stroke, beside what noise alone would give. Numbers only."""

from dataclasses import dataclass, field

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.device import BoolArray, IntArray, RunData

N_STROKE = 20
N_SHIFTS = 3  # enough for a band


@dataclass(frozen=True, eq=False)
class StrokeProfile:
    """Mean residual over stroke of one run and direction, arrays of shape (n_bins,)."""

    # centre_mm, mean_kN: middle of the bin and mean residual there
    centre_mm: FloatArray = field(repr=False)
    mean_kN: FloatArray = field(repr=False)
    # low_kN, high_kN: 5 and 95 % of what noise alone would give
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


def stroke_profiles(run: RunData) -> tuple[StrokeProfile, StrokeProfile]:
    """Mean residual over stroke for push and pull, beside what noise alone would give."""
    edges = edges_of(run.displacement_mm, N_STROKE)
    index, left = index_in(run.displacement_mm, edges), residual(run)
    noise = run.predicted_kN - run.law_kN
    # The fitted noise is stationary, so each draw may be moved in time to give several.
    shifts = np.linspace(0, noise.shape[1], N_SHIFTS, endpoint=False).astype(int)
    out = []
    for sign in (1, -1):
        inside = counted(run) & (run.direction == sign)
        mean = bin_means(index, left, inside, N_STROKE)
        there = np.isfinite(mean)
        alone = [bin_means(index, np.roll(row, step), inside, N_STROKE)[there] for row in noise for step in shifts]
        low, high = np.quantile(alone, (0.05, 0.95), axis=0)
        out.append(StrokeProfile(0.5 * (edges[:-1] + edges[1:])[there], mean[there], low, high))
    return out[0], out[1]


def edges_of(values: FloatArray, n_bins: int) -> FloatArray:
    """Edges of even bins over the range of values."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high if high > low else low + 1.0, n_bins + 1)


def index_in(values: FloatArray, edges: FloatArray) -> IntArray:
    """Bin of each value."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2).astype(np.int64)


def bin_means(index: IntArray, what: FloatArray, inside: BoolArray, size: int, fewest: int = 1) -> FloatArray:
    """Mean of the samples of each bin; nan where there are fewer than `fewest`."""
    count = np.bincount(index[inside], minlength=size)
    total = np.bincount(index[inside], weights=what[inside], minlength=size)
    return np.where(count >= fewest, total / np.maximum(count, 1), np.nan)
