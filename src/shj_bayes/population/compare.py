"""Two sets, or two kinds of sets, side by side: how far apart, how sure, and what so few devices can say."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import pandas as pd
from scipy.special import ndtr

from shj_bayes.errors import PopulationError
from shj_bayes.population.classical import Classical, classical, holm
from shj_bayes.population.compare_words import ROPE_SPEED, multiplicity_words, sentence
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.power import assurance, devices_needed, representative
from shj_bayes.population.quantities import QUANTITIES, Band, FloatArray, band_of
from shj_bayes.population.selectors import Stratum, strata_of

ROPE = 0.10
"""Half-width of the region of practical equivalence: 10 % of the value; for gamma 10 % of the force at 10 mm/s."""


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
    sentence: str  # the same in words; "settled" only when every prior of the spread says so


@dataclass(frozen=True)
class Comparison:
    """Two sides compared in every pooled quantity."""

    set_a: str
    set_b: str
    contrasts: tuple[Contrast, ...]  # one per quantity
    strata: int = 1  # pairs of sets that the comparison runs over; 1 for two sets
    multiplicity: str = ""  # how many comparisons were made here, and how that is allowed for

    def to_table(self) -> pd.DataFrame:
        """One row per quantity."""
        return pd.DataFrame([{"set_a": self.set_a, "set_b": self.set_b, **_row(c)} for c in self.contrasts])


def _row(c: Contrast) -> dict[str, object]:
    def own(*names: str) -> dict[str, object]:
        return {name: getattr(c, name) for name in names}

    def levels(name: str, band: Band) -> dict[str, object]:
        return dict(zip((f"{name}_q05", f"{name}_q50", f"{name}_q95"), band, strict=True))

    return {
        **own("quantity", "kind", "unit", "q05", "q50", "q95"),
        **{f"q05_{label}": band[0] for label, band in c.other_priors.items()},
        **{f"q95_{label}": band[1] for label, band in c.other_priors.items()},
        **levels("difference", c.difference),
        **own("difference_unit", "probability_level", "superiority", "probability_rope"),
        **{"rope_low": c.rope[0], "rope_high": c.rope[1]},
        **levels("spread_factor", c.spread_factor),
        **own("n_a", "n_b"),
        **asdict(c.tests),
        **own("holm_p", "holm_test", "power_edge", "n_to_decide", "sentence"),
    }


def compare(result: PopulationResult, set_a: str, set_b: str, *, rope: float = ROPE) -> Comparison:
    """Compare two sets, or two kinds of sets, of a fitted population.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    set_a, set_b : str
        Names of two different sets, or two kinds of sets: "coated" and "uncoated", "corroded" and "uncorroded", "70 %"
        and "100 %". Kinds are compared stratum by stratum, each stratum alike in all else, and averaged.
    rope : float
        Half-width of the region of practical equivalence, as a share.

    Raises
    ------
    PopulationError
        If a set is unknown, both are the same, or no sets differ in that respect alone.
    """
    if not 0 < rope < 1:
        raise PopulationError(f"the region of practical equivalence must be a share between 0 and 1; got {rope:g}")
    a, b, strata = strata_of(result, set_a, set_b)
    drafts = [_contrast(result, name, (a, b), strata, rope) for name in result.posteriors]
    n_tests = sum(c.tests.welch_p is not None or c.tests.permutation_p is not None for c in drafts)
    tests = [c.tests.leading(n_tests) for c in drafts]
    adjusted = holm([p for _, p in tests])
    contrasts = tuple(
        replace(c, holm_test=name, holm_p=p) for c, (name, _), p in zip(drafts, tests, adjusted, strict=True)
    )
    words = multiplicity_words(len(contrasts), len(strata), [c.holm_test for c in contrasts])
    return Comparison(a, b, contrasts, len(strata), words)


def shift_of(result: PopulationResult, name: str, strata: Sequence[Stratum], prior: str) -> FloatArray:
    """Draws of the difference of levels, pooled scale, averaged over strata."""
    mu = result.fit(name, prior).mu
    return np.asarray(np.mean([mu[:, a].mean(axis=1) - mu[:, b].mean(axis=1) for a, b in strata], axis=0))


def _contrast(
    result: PopulationResult, name: str, sides: tuple[str, str], strata: Sequence[Stratum], rope: float
) -> Contrast:
    fit, q = result.fit(name), QUANTITIES[name]

    def points(of_sets: list[int]) -> FloatArray:
        values = np.concatenate([np.array(result.sets[i].points.get(name, ()), dtype=np.float64) for i in of_sets])
        return np.asarray(values[np.isfinite(values)])

    shift = shift_of(result, name, strata, "default")
    band = band_of(q.natural(shift))
    others = {label: band_of(q.natural(shift_of(result, name, strata, label))) for label in result.other_priors}
    none = 1.0 if q.logarithmic else 0.0
    settled = {label: not x[0] < none < x[2] for label, x in {"default": band, **others}.items()}
    first, second = ([i for s in strata for i in s[side]] for side in (0, 1))
    n = (sum(fit.n_devices[i] for i in first), sum(fit.n_devices[i] for i in second))
    tau_a, tau_b = (np.exp(np.log(fit.tau[:, side]).mean(axis=1)) for side in (first, second))
    region = (1.0 / (1.0 + rope), 1.0 + rope) if q.logarithmic else (-rope / ROPE_SPEED, rope / ROPE_SPEED)
    inside = (q.natural(shift) > region[0]) & (q.natural(shift) < region[1])
    # Planned with the spread of the sets if all spread nearly alike: two devices that happen to agree promise a spread
    # that the next two will not keep.
    planned = result.fit(name, "alike" if "alike" in result.other_priors else "default").tau[:, [*first, *second]]
    spreads = representative(np.sqrt(np.mean(planned**2, axis=1)))
    edge = math.log1p(rope) if q.logarithmic else region[1]
    apart = [q.natural(fit.mu[:, a].mean(axis=1)) - q.natural(fit.mu[:, b].mean(axis=1)) for a, b in strata]
    away = [
        ndtr((fit.mu[:, [i]] - fit.mu[:, [j]]) / np.hypot(fit.tau[:, [i]], fit.tau[:, [j]]))
        for one, other in strata
        for i in one
        for j in other
    ]
    contrast = Contrast(
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
        tests=classical([(points(a), points(b)) for a, b in strata], result.seed),
        holm_p=None,
        holm_test="",
        power_edge=assurance(edge, spreads, *n, strata=len(strata)),
        n_to_decide=devices_needed(edge, spreads, strata=len(strata)),
        other_priors={label: (x[0], x[2]) for label, x in others.items()},
        sentence="",
    )
    return replace(contrast, sentence=sentence(contrast, sides, settled, rope))
