"""Intervals that do not trust the noise model: how much the parameters scatter from cycle to cycle.

The infinitesimal jackknife (Giordano, Stephenson, Liu, Jordan and Broderick 2019, AISTATS; the sandwich of Huber
1967): with the score g_c of cycle c and the covariance S of the posterior, the parameters scatter as
S (sum g_c g_c') S, whatever the noise is. Where the model holds this is S again. A law that is a little wrong is wrong
alike in all cycles of one amplitude, so stretches of equal amplitude are left out as well; the wider of both counts.

What chance does: cycles tell unequally much, so the sum over few that tell nearly all scatters more than one over many.
With the information I_c of a cycle, v_c = (S I_c S)_pp, the sum for parameter p has (sum v)^2 / sum v^2 degrees of
freedom (Satterthwaite 1946, Biometrics Bulletin 2, 110-114). The score of a variance is the square of few independent
numbers, two or so of a slow noise in a cycle: its square scatters four times as much as that of a normal one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from shj_bayes.inference.posterior import Posterior
from shj_bayes.inference.start import Start
from shj_bayes.model.noise.filter import whiten
from shj_bayes.model.parameters import FloatArray

CHANCE = 0.01  # of calling the intervals of a right model too narrow, over all its parameters
SAME_AMPLITUDE = 0.05  # of the largest: cycles of one stretch
OF_VARIANCES = 4.0  # by how much the squares of their scores scatter more
FEWEST = 6  # pieces; fewer say too little of their scatter
STEP = 0.1  # of a posterior standard deviation, for the scores


@dataclass(frozen=True, eq=False)
class Widening:
    """By how much the intervals of a posterior must be wider for what the cycles scatter."""

    names: tuple[str, ...]
    factor: FloatArray  # shape (d,): widening of each parameter's interval, 1 or more
    # shape (d,): standard deviation from cycle to cycle over that of the posterior, as it was found
    scatter: FloatArray
    n_pieces: int  # pieces that were left out one at a time; 0 where there are too few to say

    @property
    def widened(self) -> tuple[str, ...]:
        """Parameters whose intervals are wider than the posterior."""
        return tuple(name for name, factor in zip(self.names, self.factor, strict=True) if factor > 1.0)

    def spread(self, chains: FloatArray, centre: FloatArray) -> FloatArray:
        """Widen draws in the unbounded space, shape (..., d), around a centre of shape (d,)."""
        return np.asarray(centre + (chains - centre) * self.factor)


def widening_of(posterior: Posterior, start: Start) -> Widening:
    """Compare the width of a posterior with the scatter from cycle to cycle at its top."""
    scores, information = _scores(posterior, start), _information(posterior, start)
    sd, n_law = np.sqrt(np.diag(start.covariance)), posterior.model.n_law
    told = posterior.model.predicted
    law = start.covariance[:n_law, :n_law]
    scatter, factor = np.zeros(sd.size), np.ones(sd.size)
    n_pieces = 0
    for pieces in (cycles_through([run.motion.n_half for run in posterior.runs]), _stretches(posterior)):
        n = int(pieces[-1]) + 1
        if n < FEWEST:
            continue
        n_pieces = max(n_pieces, n)
        of_piece = np.stack([np.bincount(pieces, weights=column, minlength=n) for column in scores.T], axis=1)
        moves = (of_piece - of_piece.mean(axis=0)) @ start.covariance
        ratio = np.sqrt(n / (n - 1) * np.sum(moves**2, axis=0)) / sd
        share = np.zeros((n, n_law, n_law))
        np.add.at(share, pieces, information)
        variance = np.einsum("ip,cij,jp->cp", law, share, law)
        free = np.full(sd.size, (n - 1) / OF_VARIANCES)
        free[:n_law] = variance.sum(axis=0) ** 2 / np.sum(variance**2, axis=0) * (n - 1) / n
        limit = np.sqrt(chdtri(free, CHANCE / told.sum() / 2.0) / free)
        scatter = np.maximum(scatter, ratio)
        factor = np.maximum(factor, np.where(told & (ratio > limit), ratio, 1.0))
    # The prior holds what the cycles do not: no interval need be wider than its own.
    factor = np.minimum(factor, np.maximum(1.0, 1.0 / sd))
    return Widening(posterior.names, factor, scatter, n_pieces)


def _scores(posterior: Posterior, start: Start) -> FloatArray:
    """Give the derivatives of each half-cycle's log likelihood after the unbounded parameters, shape (n_half, d)."""
    width = STEP * np.sqrt(np.diag(start.covariance))
    points = np.concatenate([start.free + np.diag(width), start.free - np.diag(width)])
    value = posterior.log_likelihood_by_half_cycle(posterior.natural(points))
    above, below = np.split(value, 2)
    return np.asarray(((above - below) / (2.0 * width[:, None])).T)


def _information(posterior: Posterior, start: Start) -> FloatArray:
    """Give what each half-cycle is expected to tell of the parameters of the law, shape (n_half, n_law, n_law)."""
    model, out = posterior.model, []
    theta = posterior.natural(start.free[None])
    noise = {name: float(values[0]) for name, values in model.noise_values(theta).items()}
    width = STEP * np.sqrt(np.diag(start.covariance))[: model.n_law]
    moves = np.eye(start.free.size)[: model.n_law] * width[:, None]
    around = posterior.natural(np.concatenate([start.free + moves, start.free - moves]))
    for run, part in enumerate(posterior.averages, start=1):
        above, below = np.split(posterior.residual_and_slope(around, run)[0], 2)
        slope = posterior.residual_and_slope(theta, run)[1][0]
        rows, _ = whiten(model.noise, noise, ((above - below) / (2.0 * width[:, None])).T, slope, part.timing)
        half = np.repeat(np.arange(part.timing.half.size - 1), np.diff(part.timing.half))[part.timing.kind >= 0]
        own = np.zeros((part.timing.half.size - 1, model.n_law, model.n_law))
        np.add.at(own, half, rows[:, :, None] * rows[:, None, :])
        out.append(own)
    return np.concatenate(out)


def cycles_through(n_half: Sequence[int], width: int = 2) -> NDArray[np.int64]:
    """Cycle of each half-cycle of runs that have so many, a cycle being `width` of them, numbered through all runs.

    The first half-cycle of a run is a quarter and joins the cycle after it.
    """
    out, count = [], 0
    for n in n_half:
        own = np.maximum(np.arange(n) - 1, 0) // width
        out.append(count + own)
        count += int(own[-1]) + 1
    return np.concatenate(out)


def _stretches(posterior: Posterior) -> NDArray[np.int64]:
    """Stretch of neighbouring half-cycles of equal amplitude that each half-cycle belongs to."""
    amplitudes = [history.amplitude_mm[history.motion.start[:-1]] for history in posterior.histories]
    largest = posterior.histories[0].half_stroke_mm
    run = np.concatenate([np.full(a.size, i) for i, a in enumerate(amplitudes)])
    place = np.round(np.concatenate(amplitudes) / (SAME_AMPLITUDE * largest))
    return np.concatenate([[0], np.cumsum((np.diff(place) != 0) | (np.diff(run) != 0))])
