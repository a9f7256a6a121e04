"""Two sets, or two kinds of sets, compared: tests, their power, differences, pair by pair and together."""

from __future__ import annotations

import itertools
import math
import re
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri, ndtr, stdtr, stdtrit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PopulationError
from shj_bayes.population.device import Tags
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.quantities import Band, band_of, quantity

Stratum = tuple[list[int], list[int]]
"""Positions of the sets on both sides; all else is alike."""
Kind = tuple[Callable[[Tags], bool], Mapping[str, Any]]
"""Which sets belong, and what is put in the place of the tags compared: sets that are alike then form a stratum."""
BARE = {"", "none", "bare", "uncoated", "plain", "machined", "polished", "mill scale", "as rolled"}
"""Words for a surface that nothing was done to. A blasted one is a coating, as in the paper (Tables 4 to 7)."""
KINDS: dict[str, Kind] = {
    "coated": (lambda tags: not is_bare(tags.coating), {"coating": "", "coverage_percent": None}),
    "uncoated": (lambda tags: is_bare(tags.coating), {"coating": "", "coverage_percent": None}),
    "corroded": (lambda tags: tags.corroded, {"corroded": False}),
    "uncorroded": (lambda tags: not tags.corroded, {"corroded": False}),
}
WORDS = "coated, uncoated, corroded, uncorroded, or a coverage such as '70 %'"


def strata_of(result: PopulationResult, first: str, second: str) -> tuple[str, str, tuple[Stratum, ...]]:
    """Find the sets to compare: two sets by name, or two kinds of sets.

    Gives both sides by name, and the positions of their sets, stratum by stratum; all else is alike within a stratum.
    `PopulationError` if a set is unknown, both are the same, or no two sets differ in what is compared alone.
    """
    kinds = [kind for words in (first, second) if (kind := _kind(result, words))]
    if not kinds:
        i, j = result.index(first), result.index(second)
        if i == j:
            raise PopulationError(f"a set cannot be compared with itself ({first!r}); name two different sets")
        return result.set_names[i], result.set_names[j], (([i], [j]),)
    if len(kinds) == 1:
        raise PopulationError(f"compare two sets, or two kinds of sets ({WORDS}); got {first!r} and {second!r}")
    sides: list[dict[Tags, list[int]]] = [{}, {}]
    for i, group in enumerate(result.sets):
        for side, (belongs, compared) in zip(sides, kinds, strict=True):
            if belongs(group.tags):
                side.setdefault(replace(group.tags, **compared), []).append(i)
    found = tuple((a, sides[1][rest]) for rest, a in sides[0].items() if rest in sides[1])
    if not found or any(set(a) & set(b) for a, b in found):
        raise PopulationError(
            f"no two sets differ in '{first}' against '{second}' alone; the tags of the sets (material, coating, "
            "coverage_percent, corroded in the manifest) say what each is; or name two sets: "
            f"{', '.join(map(repr, result.set_names[:12]))}"
        )
    return first, second, found


def _kind(result: PopulationResult, words: str) -> Kind | None:
    """Read a kind of sets from words; None for the name of a set, which goes first."""
    folded = words.strip().casefold()
    if folded in {name.casefold() for name in result.set_names}:
        return None
    if match := re.fullmatch(r"(?:coverage\s*)?(\d+(?:\.\d+)?)\s*%?", folded):
        percent = float(match[1])
        return (lambda tags: tags.coverage_percent == percent), {"coverage_percent": None}
    return KINDS.get(folded.replace("not ", "un"))


def is_bare(coating: str) -> bool:
    """Whether a coating is none: bare steel."""
    return re.sub(r"[\s_-]+", " ", coating.strip().casefold()) in BARE


def members(result: PopulationResult, strata: tuple[Stratum, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the sets on both sides of a comparison, in the order of the population."""
    names = result.set_names
    first, second = (tuple(names[i] for i in sorted({i for s in strata for i in s[side]})) for side in (0, 1))
    return first, second


LEVEL, POWER = 0.05, 0.8
MOST = 10_000
N_SPREADS, _EVERY = 200, 8
"""Equally probable values that stand for the posterior of the spread; every eighth tells where to look."""


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Give shares of the law of an estimated spread, and their weights (Gauss and Legendre)."""
    share, weight = np.polynomial.legendre.leggauss(200)
    return 0.5 * (share + 1.0), 0.5 * weight


def assurance(shift: float, sds: FloatArray | float, n_a: int, n_b: int, *, strata: int = 1) -> float:
    """Power of the two-sided t test of two samples at `LEVEL`, averaged over what is known of the spread.

    `sds` are equally probable values of the spread between devices of a set, pooled scale as the true difference
    `shift`. The devices are divided over `strata` pairs of sets; each takes two degrees of freedom. 0 where there are
    too few devices for any t test. The noncentral t is integrated over the estimate of the spread, because the
    distribution function of scipy gives NaN far out.
    """
    sds = np.atleast_1d(np.asarray(sds, dtype=np.float64))
    if not (math.isfinite(shift) and np.all(np.isfinite(sds)) and np.all(sds > 0)):
        raise PopulationError(
            f"power needs a finite difference and a spread above zero; got {shift:g} and {np.min(sds):g}"
        )
    nu = n_a + n_b - 2 * strata
    if min(n_a, n_b) < 1 or nu < 1:
        return 0.0
    away = np.abs(shift) / (sds * math.sqrt(1.0 / n_a + 1.0 / n_b))
    share, weight = _nodes()
    limit = -float(stdtrit(nu, LEVEL / 2.0)) * np.sqrt(chdtri(nu, share) / nu)
    found = ndtr(away[:, None] - limit) + ndtr(-away[:, None] - limit)
    return float(np.mean(found @ weight))


def devices_needed(shift: float, sds: FloatArray | float, *, strata: int = 1) -> int:
    """Devices on each side for which the `assurance` reaches `POWER`; `MOST` when more would be needed."""
    sds = np.atleast_1d(np.asarray(sds, dtype=np.float64))

    def reached(n: int, spreads: FloatArray = sds) -> bool:
        return assurance(shift, spreads, n, n, strata=strata) >= POWER

    few = np.sort(sds)[_EVERY // 2 :: _EVERY] if sds.size >= _EVERY else sds
    low = high = strata + bisect_left(range(strata, MOST), True, key=lambda n: reached(n, few))  # next to the answer
    step = 1
    while high < MOST and not reached(high):
        low, high, step = high + 1, min(high + step, MOST), 2 * step
    while low > strata and reached(low - 1):
        low, high, step = max(low - step, strata), low - 1, 2 * step
    return low + bisect_left(range(low, high), True, key=reached)


MOST_ARRANGEMENTS = 500_000
N_RANDOM = 20_000
_SAME = 1e-9
Pair = tuple[FloatArray, FloatArray]
"""Values of the first and of the second side of one stratum, pooled scale."""


@dataclass(frozen=True)
class Classical:
    """Tests of one quantity; None where a test cannot be made."""

    welch_p: float | None  # Welch's test, two-sided; over strata with Satterthwaite's degrees of freedom
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
    return Classical(welch(full), p, n, least)


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
    raised = np.maximum.accumulate([min(1.0, (len(known) - rank) * p) for rank, (p, _) in enumerate(known)] or [1.0])
    adjusted = {i: float(p) for (_, i), p in zip(known, raised, strict=False)}
    return [adjusted.get(i) for i in range(len(p_values))]


ROPE_SPEED = 10.0
"""Speed at which practical equivalence of gamma is meant as a share of the force, mm/s."""
ROPE = 0.10
"""Half-width of the region of practical equivalence: 10 % of the value; for gamma 10 % of the force at 10 mm/s."""


FEWEST = 2
"""Devices below which a set says nothing of its own spread."""
ALONE = 0.10
"""Two-sided level of a test that goes with a 90 % interval."""


class Direction(StrEnum):
    """How far the direction of a difference is known, from best to least.

    ``SETTLED``, whatever is assumed of the spread, must hold with nothing assumed: every prior gives the direction,
    every set has `FEWEST` devices, without which its spread is assumption alone, and so does the test that takes the
    spread from these devices alone (p of `Classical.leading` at most `ALONE`).
    """

    SETTLED = "settled"
    TRIED = "under every prior tried"  # every prior gives the direction, these devices alone do not
    ASSUMED = "hangs on the prior"  # the default prior gives it, another one does not
    OPEN = "open"


class PairContrast(NamedTuple):
    """Two sets (or groups of sets) alike in all else, in one quantity: what their devices showed."""

    set_a: str
    set_b: str
    # devices and their values, natural unit
    devices_a: Mapping[str, float]
    devices_b: Mapping[str, float]
    observed: float | None  # quotient (difference for gamma) of the means of the devices; None where a side has none


@dataclass(frozen=True)
class Contrast:
    """One quantity of a against b."""

    # quantity, unit: what is compared; the unit is "1" for a quotient
    quantity: str
    unit: str
    kind: str  # "quotient", "difference": a/b for K, Fy, ratio, beta; a - b for gamma
    # q05 to q95: of the quotient or difference between the typical devices (medians) of both sides
    q05: float
    q50: float
    q95: float
    difference: Band  # 5, 50 and 95 % of a - b of typical devices in ``difference_unit``
    difference_unit: str  # unit of the quantity
    probability_level: float  # probability that the typical device of a is above that of b
    superiority: float  # probability that a new device of a is above a new device of b
    rope: tuple[float, float]  # region of practical equivalence, of the quotient or difference
    probability_rope: float  # probability that the typical devices differ by less than that
    # n_a, n_b: devices that give the quantity
    n_a: int
    n_b: int
    spread_factor: Band  # 5, 50 and 95 % of tau_a / tau_b
    tests: Classical  # Welch, Behrens-Fisher, variances, permutation on the point values
    # p of ``holm_test``, adjusted for all quantities compared here; None where no test of these devices can reach 0.05
    # after the adjustment
    holm_p: float | None
    holm_test: str  # "permutation" where it can reach 0.05 after the adjustment, otherwise "Welch"; "" for neither
    # chance that a sample of this size finds a true difference at the edge of practical equivalence, averaged over what
    # is known of the spread
    power_edge: float
    n_to_decide: int  # devices a side that would find a difference at that edge with a power of 0.80, averaged likewise
    other_priors: Mapping[str, tuple[float, float]]  # 5 and 95 % under each other prior of the spread
    direction: Direction  # how far it is known which side is above
    fewest: int  # devices of the smallest of the sets compared
    pairs: tuple[PairContrast, ...]  # stratum by stratum
    observed: float | None  # mean of what the pairs showed: geometric of quotients; None where a pair lacks devices

    @property
    def none(self) -> float:
        """Value of no difference."""
        return 1.0 if self.kind == "quotient" else 0.0


def row_of(c: Contrast) -> dict[str, object]:
    """Flatten a contrast for tables and machines, without its pairs."""
    named = {"pairs", "tests", "difference", "spread_factor", "rope", "other_priors"}
    row: dict[str, object] = {f.name: getattr(c, f.name) for f in fields(c) if f.name not in named}
    row |= asdict(c.tests) | {"rope_low": c.rope[0], "rope_high": c.rope[1], "direction": str(c.direction)}
    for label, (low, high) in c.other_priors.items():
        row |= {f"q05_{label}": low, f"q95_{label}": high}
    for name, band in (("difference", c.difference), ("spread_factor", c.spread_factor)):
        row |= dict(zip((f"{name}_q05", f"{name}_q50", f"{name}_q95"), band, strict=True))
    return row


def compare(
    result: PopulationResult, set_a: str, set_b: str, *, rope: float = ROPE, names: Sequence[str] = ()
) -> tuple[Contrast, ...]:
    """Compare two sets, or two kinds of sets, of a fitted population in every pooled quantity.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    set_a, set_b : str
        Names of two different sets, or two kinds of sets: "coated" and "uncoated", "corroded" and "uncorroded", "70 %"
        and "100 %". Kinds are compared stratum by stratum, each stratum alike in all else, and averaged.
    rope : float
        Half-width of the region of practical equivalence, as a share.
    names : sequence of str
        Quantities to compare, all of them by default. Holm's adjustment counts these.

    Raises
    ------
    PopulationError
        If a set is unknown, both are the same, or no sets differ in that respect alone.
    """
    if not 0 < rope < 1:
        raise PopulationError(f"the region of practical equivalence must be a share between 0 and 1; got {rope:g}")
    strata = strata_of(result, set_a, set_b)[2]
    drafts = [_contrast(result, name, strata, rope) for name in (names or result.posteriors)]
    n_tests = sum(c.tests.welch_p is not None or c.tests.permutation_p is not None for c in drafts)
    tests = [c.tests.leading(n_tests) for c in drafts]
    adjusted = holm([p for _, p in tests])
    return tuple(replace(c, holm_test=name, holm_p=p) for c, (name, _), p in zip(drafts, tests, adjusted, strict=True))


def shift_of(result: PopulationResult, name: str, strata: Sequence[Stratum], prior: str) -> FloatArray:
    """Draws of the difference of levels, pooled scale, averaged over strata."""
    mu = result.fit(name, prior).mu
    return np.asarray(np.mean([mu[:, a].mean(axis=1) - mu[:, b].mean(axis=1) for a, b in strata], axis=0))


def _pairs(
    result: PopulationResult, name: str, strata: Sequence[Stratum]
) -> tuple[tuple[PairContrast, ...], list[Pair]]:
    """Give what the devices of each stratum showed, and their values on the pooled scale."""
    natural, out, values = quantity(name).natural, [], []
    for stratum in strata:
        sides = [[result.sets[i] for i in of_sets] for of_sets in stratum]
        a, b = (
            {
                f"{g.name}, {device}" if len(groups) > 1 else device: point
                for g in groups
                for device, point in zip(g.devices, g.points.get(name, ()), strict=False)
                if math.isfinite(point)
            }
            for groups in sides
        )
        both = np.array(list(a.values())), np.array(list(b.values()))
        seen = float(natural(both[0].mean() - both[1].mean())) if a and b else None
        first, second = (" and ".join(g.name for g in groups) for groups in sides)
        shown_a, shown_b = ({device: float(natural(x)) for device, x in found.items()} for found in (a, b))
        out.append(PairContrast(first, second, shown_a, shown_b, seen))
        values.append(both)
    return tuple(out), values


def direction_of(
    result: PopulationResult, name: str, strata: Sequence[Stratum], values: Sequence[Pair] | None = None
) -> Direction:
    """Say how far the direction of a difference is known; `values` are those of the devices, stratum by stratum."""
    values = _pairs(result, name, strata)[1] if values is None else values
    ends = [band_of(shift_of(result, name, strata, label)) for label in ("default", *result.other_priors)]
    above = [low > 0 or high < 0 for low, _, high in ends]
    if not all(above):
        return Direction.ASSUMED if above[0] else Direction.OPEN
    alone = classical(values, result.seed).leading(1)[1]
    fewest = min(result.fit(name).n_devices[i] for stratum in strata for side in stratum for i in side)
    if fewest < FEWEST or alone is None or alone > ALONE:
        return Direction.TRIED
    shown = sum(float(a.mean() - b.mean()) for a, b in values)
    return Direction.SETTLED if shown * ends[0][1] > 0 else Direction.TRIED


def _contrast(result: PopulationResult, name: str, strata: Sequence[Stratum], rope: float) -> Contrast:
    fit, q = result.fit(name), quantity(name)
    pairs, values = _pairs(result, name, strata)
    tests = classical(values, result.seed)
    shown = np.mean([a.mean() - b.mean() for a, b in values]) if all(a.size and b.size for a, b in values) else None
    shift = shift_of(result, name, strata, "default")
    band = band_of(q.natural(shift))
    others = {label: band_of(q.natural(shift_of(result, name, strata, label))) for label in result.other_priors}
    first, second = ([i for s in strata for i in s[side]] for side in (0, 1))
    n = (sum(fit.n_devices[i] for i in first), sum(fit.n_devices[i] for i in second))
    tau_a, tau_b = (np.exp(np.log(fit.tau[:, side]).mean(axis=1)) for side in (first, second))
    region = (1.0 / (1.0 + rope), 1.0 + rope) if q.logarithmic else (-rope / ROPE_SPEED, rope / ROPE_SPEED)
    inside = (q.natural(shift) > region[0]) & (q.natural(shift) < region[1])
    # Planned with the spread of the sets if all spread nearly alike: two devices that happen to agree promise a spread
    # that the next two will not keep.
    planned = result.fit(name, "alike" if "alike" in result.other_priors else "default").tau[:, [*first, *second]]
    spreads = np.quantile(np.sqrt(np.mean(planned**2, axis=1)), (np.arange(N_SPREADS) + 0.5) / N_SPREADS)
    edge = math.log1p(rope) if q.logarithmic else region[1]
    apart = [q.natural(fit.mu[:, a].mean(axis=1)) - q.natural(fit.mu[:, b].mean(axis=1)) for a, b in strata]
    away = [
        ndtr((fit.mu[:, [i]] - fit.mu[:, [j]]) / np.hypot(fit.tau[:, [i]], fit.tau[:, [j]]))
        for one, other in strata
        for i in one
        for j in other
    ]
    return Contrast(
        quantity=name,
        unit="1" if q.logarithmic else q.unit,
        kind="quotient" if q.logarithmic else "difference",
        q05=band[0],
        q50=band[1],
        q95=band[2],
        difference=band_of(np.mean(apart, axis=0)),
        difference_unit=q.unit,
        probability_level=float(np.mean(shift > 0)),
        superiority=float(np.mean(away)),
        rope=region,
        probability_rope=float(np.mean(inside)),
        n_a=n[0],
        n_b=n[1],
        spread_factor=band_of(tau_a / tau_b),
        tests=tests,
        holm_p=None,
        holm_test="",
        power_edge=assurance(edge, spreads, *n, strata=len(strata)),
        n_to_decide=devices_needed(edge, spreads, strata=len(strata)),
        other_priors={label: (x[0], x[2]) for label, x in others.items()},
        direction=direction_of(result, name, strata, values),
        fewest=min(fit.n_devices[i] for i in (*first, *second)),
        pairs=pairs,
        observed=None if shown is None else float(q.natural(shown)),
    )
