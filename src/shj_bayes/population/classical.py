"""Classical tests beside the posterior: Welch, Behrens-Fisher, ratio of variances, exact permutation, Holm.

A comparison may run over strata (one coating, say, corroded and not); a test then adds up the strata. None of these
tests knows of rounding or of how well each device is known; the posterior does.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, stdtr, stdtrit

from shj_bayes.population.quantities import FloatArray

MOST_ARRANGEMENTS = 500_000
N_RANDOM = 20_000
LEVEL = 0.05
_NODES = (np.arange(4000) + 0.5) / 4000
_SAME = 1e-9
Pair = tuple[FloatArray, FloatArray]
"""Values of the first and of the second side of one stratum, pooled scale."""


@dataclass(frozen=True)
class Classical:
    """Tests of one quantity; None where a test cannot be made."""

    welch_p: float | None  # Welch's test, two-sided; over strata with Satterthwaite's degrees of freedom
    # Behrens-Fisher (the posterior of both means under vague priors, spreads unequal); one stratum only
    behrens_fisher_p: float | None
    variance_p: float | None  # two-sided F test that both sides spread alike
    permutation_p: float | None  # stratified permutation test of the sides, two-sided
    arrangements: int  # how many there are; above half a million a random 20 000 of them are used
    # smallest p that any assignment of these values to the two sides can give: three against three devices never give
    # less than 0.10, however far apart they lie
    permutation_least: float | None = None

    def leading(self, n_tests: int) -> tuple[str, float | None]:
        """Test that multiplicity is applied to ("permutation", "Welch", "" where neither can reach it), and its p.

        The exact permutation where its smallest attainable p, times the number of tests, is within 0.05; otherwise
        Welch's, which leans on device values that are normal on the pooled scale, as the population model does. The
        choice looks at the values but not at which side they are on, so it does not favour a result. A test that cannot
        reach the level cannot give a false alarm either and need not be counted (Tarone 1990).
        """
        if self.permutation_least is not None and n_tests * self.permutation_least <= LEVEL:
            return "permutation", self.permutation_p
        return ("Welch", self.welch_p) if self.welch_p is not None else ("", None)


def classical(strata: Sequence[Pair], seed: int = 0) -> Classical:
    """Run every test that the values of the devices, pooled scale, stratum by stratum, allow.

    `seed` is that of the random arrangements, where there are too many for all.
    """
    full = [(a, b) for a, b in strata if a.size and b.size]
    p, least, n = permutation_test(full, seed) if full else (None, None, 0)
    two = behrens_fisher(*full[0]) if len(full) == 1 else None
    return Classical(welch(full), two, variance_ratio(full), p, n, least)


def welch(strata: Sequence[Pair]) -> float | None:
    """Two-sided p of the mean difference over strata, spreads unequal."""
    sides = [side for pair in strata for side in pair]
    if not sides or min(s.size for s in sides) < 2 or max(np.ptp(s) for s in sides) < _SAME:
        return None
    variances = [float(s.var(ddof=1)) / s.size for s in sides]
    total = sum(variances)
    degrees = total**2 / sum(v**2 / (s.size - 1) for v, s in zip(variances, sides, strict=True))
    difference = sum(float(a.mean() - b.mean()) for a, b in strata)
    return float(2.0 * stdtr(degrees, -abs(difference) / math.sqrt(total)))


def behrens_fisher(a: FloatArray, b: FloatArray) -> float | None:
    """Two-sided tail probability of the Behrens-Fisher distribution (difference of two scaled t variables)."""
    if min(a.size, b.size) < 2 or min(np.ptp(a), np.ptp(b)) < _SAME:
        return None
    scale_a, scale_b = (float(x.std(ddof=1)) / math.sqrt(x.size) for x in (a, b))
    other = stdtrit(b.size - 1, _NODES)
    away = abs(float(a.mean() - b.mean()))
    return float(2.0 * np.mean(stdtr(a.size - 1, -(away + scale_b * other) / scale_a)))


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
    tail = fdtrc(degrees[0], degrees[1], f)
    return float(2.0 * min(tail, 1.0 - tail))


def permutation_test(strata: Sequence[Pair], seed: int = 0) -> tuple[float, float, int]:
    """Two-sided p value of the sum of the mean differences, sides exchanged at random within each stratum.

    Exact up to `MOST_ARRANGEMENTS`; above, of the observed arrangement and `N_RANDOM` - 1 that are drawn. Then the
    smallest p that any arrangement of these values has, and the number of arrangements.
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
    away = np.abs(sums)

    def share(of: float) -> float:
        return float(np.mean(away >= of - _SAME * max(1.0, of)))

    # Of drawn arrangements the observed one is always one, so the least is known without drawing.
    least = share(float(away.max())) if count <= MOST_ARRANGEMENTS else 1.0 / N_RANDOM
    return share(abs(observed)), least, count


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's adjustment for the number of tests that were made (Holm 1979); None stays None."""
    known = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    out: list[float | None] = [None] * len(p_values)
    highest = 0.0
    for rank, (p, i) in enumerate(known):
        highest = max(highest, min(1.0, (len(known) - rank) * p))
        out[i] = highest
    return out
