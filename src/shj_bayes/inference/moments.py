"""Sums of squared residuals of a run, exact to rounding, at a cost that hardly grows with the sampling rate.

The likelihood under independent or AR(1) noise needs three sums over the residuals r of a run: of r^2, of
(r_i - r_(i-1))^2 where a sample follows its predecessor, and of r^2 at the ends of the stretches. With D the second
and E the last one, the sum of squared innovations over 1 - phi^2, plus the squares of first samples, is

    (1 - phi) / (1 + phi) sum r^2 + phi / (1 - phi^2) D + phi / (1 + phi) E

which loses no digits where phi is near 1, as it is at high sampling rates (written with lag-one products it does).

Each half-cycle is halved again and again into blocks of neighbouring samples. A block is answered at once where the
law is saturated in it, or where it is a polynomial of the displacement to double precision (see `moments_kernel`);
else its halves are asked, and the smallest blocks go through their samples. The law is never approximated beyond
1e-11 of Fy. No order of the displacement is needed: blocks are rows of samples, so noise, rests, gaps and samples that
are no evidence change nothing. Source: Chebyshev interpolation in a Bernstein ellipse, Trefethen (2013),
Approximation Theory and Approximation Practice, chapter 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shj_bayes.inference import moments_kernel
from shj_bayes.model.law import VARIANTS
from shj_bayes.model.noise import Stretches
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion

BY_SUMS = ("independent", "ar1")  # noise models whose likelihood follows from the sums
LEAF, MAX_LEAVES = 96, 4096  # samples of the smallest blocks, and about how many of them there may be: 8 kB each
NEAR, SHARE = 2.0, 0.25  # small blocks up to twice the knee; beyond it blocks may span a quarter of the slip so far
ROW = 16  # the samples of a leaf are filled up to whole vectors
CANCELLED = 1e-8  # squares that are smaller than this part of what they are the difference of are not trusted


@dataclass(frozen=True, eq=False)
class Moments:
    """A run as its blocks.

    Parameters
    ----------
    motion : tuple of array
        Turning points (mm) and directions of the half-cycles.
    tree : tuple of array
        Blocks (begin, end, next block beside, is leaf), wholes before parts, and the first block of each half-cycle.
    sums : tuple of array
        Range of displacement, scalars, vectors and matrices of each block.
    packed : tuple of array
        Displacement, speed, force and weights of the samples of the leaves, and where each leaf begins.
    ends : tuple of array
        Samples (displacement, speed, force) at the ends of stretches and beside reversals, how often each counts,
        whether it follows the one before, and its half-cycle.
    """

    motion: tuple[Any, ...]
    tree: tuple[Any, ...]
    sums: tuple[Any, ...]
    packed: tuple[Any, ...]
    ends: tuple[Any, ...]

    def residual_sums(
        self, laws: FloatArray, *, variant: str = "seed", start_force_kN: float = 0.0
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Give the sums of squares, of squared differences and of squares at the ends, for many parameter sets.

        Parameters
        ----------
        laws : array, shape (m, 4)
            K (kN/mm), Fy (kN), beta, gamma (s/mm) of each set.
        variant : {"seed", "continuous"}
            Reversal rule.
        start_force_kN : float
            Rate-free force at the first sample, kN.

        Returns
        -------
        array, shape (m, 3)
            The sums, kN^2.
        array of bool, shape (m,)
            False where they are not to be trusted (overflow, or residuals so small that rounding shows): ask the
            samples themselves.
        """
        out = np.asarray(
            moments_kernel.sums_of_many(
                self.motion, self.tree, self.sums, self.packed, self.ends, laws, start_force_kN, VARIANTS[variant]
            )
        )
        sound = np.all(np.isfinite(out), axis=1) & (out[:, 0] >= CANCELLED * out[:, 3]) & (out[:, 1] >= 0.0)
        return out[:, :3], sound


def moments_of(motion: Motion, force_kN: FloatArray, stretches: Stretches, leaf: int = 0) -> Moments:
    """Precompute the blocks of a run.

    Parameters
    ----------
    motion : Motion
        Half-cycles, displacement and speed.
    force_kN : array, shape (n_samples,)
        Measured force, kN.
    stretches : Stretches
        Which samples count and which follow their predecessor.
    leaf : int
        Samples of the smallest blocks (they hold fewer than twice as many); 0 chooses.

    Returns
    -------
    Moments
    """
    x, v = motion.displacement_mm, motion.speed_mm_s
    kind = stretches.kind
    counts, follows = (kind > 0).astype(np.float64), (kind == 2).astype(np.float64)
    across = np.flatnonzero(kind[motion.start[:-1]] == 2)  # reversals between a sample and the one it follows
    follows[motion.start[:-1]] = 0.0
    y = np.asarray(force_kN, dtype=np.float64)
    slip = np.abs(x - motion.turning_mm[motion.half_cycle])
    near = NEAR * _knee(motion, y, slip)
    if leaf == 0:
        leaf = max(LEAF, int(np.count_nonzero(slip < near)) // MAX_LEAVES)
    blocks, of_half = _halve(motion.start.tolist(), slip, near, leaf)
    sums = moments_kernel.build((x, v, y, counts, follows), motion.start, blocks, of_half)
    packed = _pack((x, v, y, counts, follows), motion.start, blocks, of_half)
    ends = _ends((x, v, y), kind, motion, motion.start[across])
    return Moments((motion.turning_mm, motion.direction), (blocks, of_half), sums, packed, ends)


def log_density_of_sums(
    model: str, sums: FloatArray, stretches: Stretches, *, sigma: FloatArray, phi: FloatArray | None = None
) -> FloatArray:
    """Log density of independent or AR(1) noise from the three sums; the same as `noise.log_density`, shape (m,)."""
    phi = np.zeros_like(sigma) if model == "independent" or phi is None else phi
    squares, differences, ends = sums.T
    quadratic = (1 - phi) * squares + phi * ends + phi / (1 - phi) * differences
    scales = stretches.n_used * np.log(sigma) + 0.5 * stretches.n_follow * np.log1p(-(phi**2))
    return np.asarray(-0.5 * (quadratic / ((1 + phi) * sigma**2) + stretches.n_used * np.log(2 * np.pi)) - scales)


def _knee(motion: Motion, force: FloatArray, slip: FloatArray) -> float:
    """Slip at which the force typically comes to nine tenths of what it reaches in its half-cycle, mm.

    Only where blocks are cut fine depends on it, never a result.
    """
    along = force * motion.direction[motion.half_cycle]
    peak = np.maximum.reduceat(along, motion.start[:-1])
    reached = along >= 0.9 * peak[motion.half_cycle]
    first = np.minimum.reduceat(np.where(reached, slip, np.inf), motion.start[:-1])
    return float(np.median(first))


def _halve(
    start: Sequence[int], slip: FloatArray, near: float, leaf: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List the blocks of all half-cycles, wholes before parts, and the first block of each half-cycle.

    A block is halved while its halves have `leaf` samples, unless it is far from the knee and spans little of the slip:
    there it is smooth for any law that could be meant.
    """
    rows: list[list[int]] = []
    of_half = [0]
    for k in range(len(start) - 1):
        waiting = [(start[k], start[k + 1])]
        while waiting:
            a, b = waiting.pop()
            low, high = float(slip[a]), float(slip[b - 1])
            whole = b - a < 2 * leaf or (low > near and high - low < SHARE * low)
            rows.append([a, b, 0, int(whole)])
            if not whole:
                waiting += [((a + b) // 2, b), (a, (a + b) // 2)]
        beside: dict[int, int] = {start[k + 1]: len(rows)}  # the next block beside is the first that begins at the end
        for i in range(len(rows) - 1, of_half[-1] - 1, -1):
            rows[i][2] = beside[rows[i][1]]
            beside[rows[i][0]] = i
        of_half.append(len(rows))
    return np.array(rows, dtype=np.int64), np.array(of_half, dtype=np.int64)


def _pack(
    channels: tuple[FloatArray, ...],
    start: NDArray[np.int64],
    blocks: NDArray[np.int64],
    of_half: NDArray[np.int64],
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Copy the samples of the leaves, each with its predecessor before it and filled up to whole vectors."""
    half = np.repeat(np.arange(of_half.size - 1), np.diff(of_half))
    first = np.maximum(blocks[:, 0] - 1, start[half])
    length = np.where(blocks[:, 3] == 1, -(-(blocks[:, 1] - first) // ROW) * ROW, 0)
    offset = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    block = np.repeat(np.arange(length.size), length)
    index = first[block] + np.arange(offset[-1]) - offset[block]
    inside = (index >= blocks[block, 0]) & (index < blocks[block, 1])
    index = np.minimum(index, blocks[block, 1] - 1)
    weights = [channel[index] * inside for channel in channels[3:]]
    return np.stack([*(channel[index] for channel in channels[:3]), *weights]), offset


def _ends(
    channels: tuple[FloatArray, ...], kind: NDArray[np.int8], motion: Motion, across: NDArray[np.int64]
) -> tuple[Any, ...]:
    """Collect the samples at the ends of stretches and on both sides of reversals."""
    followed = np.append(kind[1:] == 2, False)
    weight = (kind == 1).astype(np.float64) + ((kind > 0) & ~followed)
    chosen = weight > 0
    chosen[across] = chosen[across - 1] = True
    index = np.flatnonzero(chosen)
    points = np.stack([channel[index] for channel in channels])
    return points, weight[index], np.isin(index, across).astype(np.int64), motion.half_cycle[index]
