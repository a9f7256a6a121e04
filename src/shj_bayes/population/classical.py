"""Classical tests beside the posterior: Welch, Behrens-Fisher, ratio of variances, exact permutation, Holm.

A comparison may run over strata (one coating, say, corroded and not); a test then adds up the strata. None of these
tests knows of rounding or of how well each device is known; the posterior does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from shj_bayes.population.quantities import FloatArray

MOST_ARRANGEMENTS = 500_000
N_RANDOM = 20_000
_NODES = (np.arange(4000) + 0.5) / 4000
_SAME = 1e-9
Pair = tuple[FloatArray, FloatArray]
"""Values of the first and of the second side of one stratum, pooled scale."""


@dataclass(frozen=True)
class Classical:
    """Tests of one quantity; None where a test cannot be made.

    Parameters
    ----------
    welch_p : float or None
        Welch's test, two-sided; over strata with Satterthwaite's degrees of freedom.
    behrens_fisher_p : float or None
        Behrens-Fisher (the posterior of both means under vague priors, spreads unequal); one stratum only.
    variance_p : float or None
        Two-sided F test that both sides spread alike.
    permutation_p : float or None
        Exact stratified permutation of the sides, two-sided.
    arrangements : int
        How many there are; above half a million a random 20 000 of them are used.
    """

    welch_p: float | None
    behrens_fisher_p: float | None
    variance_p: float | None
    permutation_p: float | None
    arrangements: int


def classical(strata: Sequence[Pair], seed: int = 0) -> Classical:
    """Run every test that the numbers allow.

    Parameters
    ----------
    strata : sequence of (a, b)
        Point values of the devices, pooled scale.
    seed : int
        Of the random arrangements, where there are too many for all.

    Returns
    -------
    Classical
    """
    full = [(a, b) for a, b in strata if a.size and b.size]
    p, n = permutation(full, seed) if full else (None, 0)
    return Classical(welch(full), behrens_fisher(*full[0]) if len(full) == 1 else None, variance_ratio(full), p, n)


def welch(strata: Sequence[Pair]) -> float | None:
    """Two-sided p of the mean difference over strata, spreads unequal."""
    sides = [side for pair in strata for side in pair]
    if not sides or min(s.size for s in sides) < 2 or max(np.ptp(s) for s in sides) < _SAME:
        return None
    variances = [float(s.var(ddof=1)) / s.size for s in sides]
    total = sum(variances)
    degrees = total**2 / sum(v**2 / (s.size - 1) for v, s in zip(variances, sides, strict=True))
    difference = sum(float(a.mean() - b.mean()) for a, b in strata)
    return float(2.0 * stats.t.sf(abs(difference) / math.sqrt(total), degrees))


def behrens_fisher(a: FloatArray, b: FloatArray) -> float | None:
    """Two-sided tail probability of the Behrens-Fisher distribution (difference of two scaled t variables)."""
    if min(a.size, b.size) < 2 or min(np.ptp(a), np.ptp(b)) < _SAME:
        return None
    scale_a, scale_b = (float(x.std(ddof=1)) / math.sqrt(x.size) for x in (a, b))
    other = stats.t.ppf(_NODES, b.size - 1)
    away = abs(float(a.mean() - b.mean()))
    return float(2.0 * np.mean(stats.t.sf((away + scale_b * other) / scale_a, a.size - 1)))


def variance_ratio(strata: Sequence[Pair]) -> float | None:
    """Two-sided p of Snedecor's F that both sides have the same variance, pooled over strata."""
    squares, degrees = [0.0, 0.0], [0, 0]
    for pair in strata:
        for i, side in enumerate(pair):
            squares[i] += float(np.sum((side - side.mean()) ** 2))
            degrees[i] += side.size - 1
    if min(degrees) < 1 or min(squares) < _SAME**2:
        return None
    f = (squares[0] / degrees[0]) / (squares[1] / degrees[1])
    tail = stats.f.sf(f, *degrees)
    return float(2.0 * min(tail, 1.0 - tail))


def permutation(strata: Sequence[Pair], seed: int = 0) -> tuple[float, int]:
    """Exact two-sided p of the mean difference over strata, sides exchanged within each stratum.

    Returns
    -------
    float, int
        p, and the number of arrangements.
    """
    observed = sum(float(a.mean() - b.mean()) for a, b in strata)
    together = [np.concatenate(pair) for pair in strata]
    count = math.prod(math.comb(x.size, a.size) for x, (a, _) in zip(together, strata, strict=True))
    if count <= MOST_ARRANGEMENTS:
        sums = np.zeros(1)
        for x, (a, b) in zip(together, strata, strict=True):
            chosen = np.array(list(itertools.combinations(range(x.size), a.size)))
            first = x[chosen].sum(axis=1)
            sums = np.add.outer(sums, first / a.size - (x.sum() - first) / b.size).ravel()
    else:
        rng = np.random.default_rng([seed, 7])
        sums = np.full(N_RANDOM, observed)
        sums[1:] = 0.0
        for x, (a, b) in zip(together, strata, strict=True):
            first = np.array([rng.permutation(x)[: a.size].sum() for _ in range(N_RANDOM - 1)])
            sums[1:] += first / a.size - (x.sum() - first) / b.size
    edge = abs(observed) - _SAME * max(1.0, abs(observed))
    return float(np.mean(np.abs(sums) >= edge)), count


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's adjustment for the number of tests that were made (Holm 1979); None stays None."""
    known = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    out: list[float | None] = [None] * len(p_values)
    highest = 0.0
    for rank, (p, i) in enumerate(known):
        highest = max(highest, min(1.0, (len(known) - rank) * p))
        out[i] = highest
    return out
