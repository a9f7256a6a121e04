"""Basis of design: bounds of the sliding force of a new device, and what ageing did to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.spread import HIGH, LOW, MIDDLE
from shj_bayes.model.parameters import base_of
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.predict import NewDevice, new_device
from shj_bayes.population.quantities import HIGHEST, LEAST, LOWEST, MOST, THIRD_CYCLE, band_of, stream

FEW = 3
DEFAULT = "default"
DEGRADATION = "degradation"
PredictiveDevices = Mapping[str, NewDevice]
"""New devices of one set by prior of the spread, the default first."""
SIDES = {LOW: 0.05, MIDDLE: 0.5, HIGH: 0.95}
Value = TypeVar("Value", float, tuple[float, float])


def predictive_devices(result: PopulationResult, set_name: str) -> dict[str, NewDevice]:
    """Draw new devices of a set under every prior of the spread that was tried, each read as the tested ones were.

    Draws of design quantities (all of them positive) have the error with which those of the set are known.
    """
    out = {}
    for label in (DEFAULT, *result.other_priors):
        device, draws = new_device(result, set_name, label), {}
        for q, values in device.draws.items():
            rng = np.random.default_rng(stream(result.seed, "reading", set_name, q))
            draws[q] = values * np.exp(reading_error(result, set_name, q) * rng.standard_normal(values.size))
        if "ratio" in draws:
            draws[DEGRADATION] = 1.0 - draws["ratio"]
        out[label] = replace(device, draws=draws)
    return out


def reading_error(result: PopulationResult, set_name: str, quantity: str) -> float:
    """Error with which devices of a set are known in a quantity: standard deviation of the logarithm."""
    groups = [group for group in result.sets if set_name in (ANY_SET, group.name)] or result.sets
    errors = np.concatenate([group.errors.get(quantity, ()) for group in groups])
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def tested_devices(result: PopulationResult, set_name: str) -> dict[str, int]:
    """Tested devices behind each quantity: of the set, or of all sets for one never tested."""
    index = slice(None) if set_name == ANY_SET else slice(i := result.index(set_name), i + 1)
    return {q: sum(fit.n_devices[index]) for q, fit in result.posteriors.items()}


def own_devices(result: PopulationResult, set_name: str, quantities: Iterable[str]) -> int:
    """Devices of a set that give all of the quantities; a set never tested has none."""
    counts = tested_devices(result, set_name)
    return 0 if set_name == ANY_SET else min(counts[q] for q in quantities if q in counts)


def priors_that_count(labels: Sequence[str], own: int) -> tuple[str, ...]:
    """Priors of the spread that a band is taken over: the default, with few devices all."""
    return tuple(labels) if own <= FEW else (DEFAULT,)


def least_favourable(by_prior: Mapping[str, Value], side: str, own: int) -> Value:
    """Least favourable value of the priors that count; the default's for the middle."""
    values = [by_prior[label] for label in priors_that_count(tuple(by_prior), own)]
    return {LOW: min(values), HIGH: max(values)}.get(side, by_prior[DEFAULT])


RANK = {LOWEST: 0, LEAST: 1, "plateau": 2, THIRD_CYCLE: 2, MOST: 3, HIGHEST: 4}
"""Forces of a device, none above those of a higher rank of the same run; the first and the last are of all runs."""


def is_part(lesser: str, greater: str) -> bool:
    """Whether a force of a device cannot be above another one."""
    a, b = base_of(lesser), base_of(greater)
    of_one_run = a == LOWEST or b == HIGHEST or lesser.removeprefix(a) == greater.removeprefix(b)
    return RANK[a] < RANK[b] and of_one_run


def levels_of(reliability: float) -> dict[str, float]:
    """Shares of devices below the lower bound, the middle and the upper bound of a force."""
    return {LOW: round(1.0 - reliability, 12), MIDDLE: 0.5, HIGH: reliability}


def force_ends(
    devices: PredictiveDevices, tested: Mapping[str, int], levels: Mapping[str, float] = SIDES
) -> dict[tuple[str, str], tuple[float, float]]:
    """Bound every force of a new device such that no part passes the whole: by force and side, value and own value.

    `tested` are the devices behind each, `levels` the shares of devices below each side. The own value is that of the
    predictive distribution of the force by itself (few devices: least favourable prior). Of a device the smallest
    plateau of all runs lies below every other force, so a lower limit of it is one of these as well, and of two limits
    the nearer one counts; likewise upwards from the largest force of all runs. Limits of the whole rest on the whole
    itself, but for a run that fewer devices have gone through than there are: what the others would have shown there is
    not in the whole, so its limit counts too.
    """
    set_name = devices[DEFAULT].set_name
    names = sorted((n for n in devices[DEFAULT].draws if base_of(n) in RANK), key=lambda n: RANK[base_of(n)])

    def own(name: str, side: str, level: float) -> float:
        by_prior = {label: d.ordered(name).quantile(level) for label, d in devices.items()}
        return least_favourable(by_prior, side, 0 if set_name == ANY_SET else tested.get(name, 0))

    alone = {side: {n: own(n, side, level) for n in names} for side, level in levels.items()}
    low, middle, high = (dict(alone[side]) for side in SIDES)
    for ends, whole, part, outer in ((low, LOWEST, LEAST, min), (high, HIGHEST, MOST, max)):
        fewer = [n for n in names if base_of(n) == part and tested.get(n, 0) < tested.get(whole, 0)]
        ends[whole] = outer(ends[n] for n in (whole, *fewer))
    for i, name in enumerate(names):
        for ends in (low, middle):
            ends[name] = max(ends[name], *(ends[n] for n in names[:i] if is_part(n, name)), -math.inf)
    for i, name in reversed(list(enumerate(names))):
        high[name] = min(high[name], *(high[n] for n in names[i + 1 :] if is_part(name, n)), math.inf)
    found = zip(SIDES, (low, middle, high), strict=True)
    return {(n, side): (ends[n], alone[side][n]) for side, ends in found for n in names}


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper factor on one property."""

    low: float  # at most 1
    high: float  # at least 1

    def __post_init__(self) -> None:
        """Refuse factors on the wrong side of 1."""
        if not 0 < self.low <= 1 <= self.high:
            raise PopulationError(
                f"property modification factors must hold 0 < lower <= 1 <= upper; got {self.low:g} and {self.high:g}"
            )

    @classmethod
    def around(cls, *factors: float) -> Bounds:
        """Narrowest bounds that hold 1 and all factors given."""
        return cls(min(1.0, *factors), max(1.0, *factors))


NONE = Bounds(1.0, 1.0)


@dataclass(frozen=True)
class SlidingForceBounds:
    """Force of a new device of one set, kN; lower and upper ends leave out the share that is `beyond`."""

    # third_low to third_high: lower end, middle and upper end of the third cycle of the first run
    third_low: float
    third: float
    third_high: float
    first_low: float  # lower end of the smallest plateau of the first run
    later_low: float | None  # the same of the later runs; None without any
    # low, high: lower end of the smallest plateau and upper end of the largest force of all runs
    low: float
    high: float
    typical: Bounds  # smallest plateau and largest force of a typical device over its third cycle
    ratio: float | None  # second run over first of a typical device, mean plateau
    # first_high, later_high: upper end of the largest force of the first run, of the later runs
    first_high: float = math.nan
    later_high: float | None = None
    beyond: float = SIDES[LOW]

    def level(self, side: str) -> str:
        """Per cent of devices below the end of a side."""
        return f"{100.0 * levels_of(round(1.0 - self.beyond, 12))[side]:.4g}"

    @property
    def words(self) -> str:
        """What the force does in the test, of a typical device."""
        said = (
            f"smallest plateau {self.typical.low:.3f} and largest force {self.typical.high:.3f} of the third cycle of "
            "the first run, at any speed from standstill to the highest tested"
        )
        return said + ("; no second run" if self.ratio is None else f"; second run / first {self.ratio:.3f}")


def sliding_force_bounds(
    devices: PredictiveDevices, tested: Mapping[str, int], reliability: float = SIDES[HIGH]
) -> SlidingForceBounds:
    """Bound the force of a new device; `tested` are the devices behind each quantity."""
    ends = {key: value for key, (value, _) in force_ends(devices, tested, levels_of(reliability)).items()}
    main = devices[DEFAULT].draws
    later, most = ([ends[n, s] for n in main if n.startswith(f"{q}_")] for q, s in ((LEAST, LOW), (MOST, HIGH)))
    third = main[THIRD_CYCLE]
    moved = [float(np.median(main[name]) / np.median(third)) for name in (LOWEST, HIGHEST)]
    return SlidingForceBounds(
        third_low=ends[THIRD_CYCLE, LOW],
        third=float(np.median(third)),
        third_high=ends[THIRD_CYCLE, HIGH],
        first_low=ends[LEAST, LOW],
        later_low=min(later, default=None),
        low=ends[LOWEST, LOW],
        high=ends[HIGHEST, HIGH],
        typical=Bounds.around(*moved),
        ratio=float(np.median(main["ratio"])) if "ratio" in main else None,
        first_high=ends[MOST, HIGH],
        later_high=max(most, default=None),
        beyond=round(1.0 - reliability, 12),
    )


@dataclass(frozen=True)
class Environment:
    """What corrosion did to the sliding force."""

    measured: Bounds  # factor on the force, middle of the posterior; 1 and 1 where it was not tested
    extreme: Bounds  # 5 and 95 % of the posterior
    words: str  # where it comes from


def environment(result: PopulationResult, set_name: str) -> Environment:
    """Corroded over uncorroded sliding force of the same shim and coating, from its posterior."""
    fit, names, pairs = result.fit(THIRD_CYCLE), result.set_names, corroded_pairs(result)
    if set_name == ANY_SET:
        origin = f"mean of {len(pairs)} corroded sets over their uncorroded partners"
    else:
        index = result.index(set_name)
        if result.sets[index].tags.corroded:
            return Environment(NONE, NONE, "this set was tested corroded: its own numbers hold the ageing")
        pairs = [(i, j) for i, j in pairs if i == index][:1]
        origin = "".join(f"{names[j]} over {set_name}" for _, j in pairs)
    if not pairs:
        untested = "no corroded partner of this set was tested: 1 says that nothing is known, not that nothing happens"
        return Environment(NONE, NONE, untested)
    shift = np.mean([fit.mu[:, j] - fit.mu[:, i] for i, j in pairs], axis=0)
    low, middle, high = (float(x) for x in np.exp(band_of(shift)))
    said = f"{origin}: {middle:.2f} (90 % interval {low:.2f} to {high:.2f})"
    return Environment(Bounds.around(middle), Bounds.around(low, high), said)


def corroded_pairs(result: PopulationResult) -> list[tuple[int, int]]:
    """Positions of (uncorroded, corroded) sets that are alike in all else."""
    sets = list(enumerate(result.sets))
    return [
        (i, j)
        for i, a in sets
        for j, b in sets
        if b.tags.corroded and not a.tags.corroded and replace(a.tags, corroded=True) == b.tags
    ]


@dataclass(frozen=True)
class DesignBasis:
    """What the factors of one set are made of."""

    # nominal sliding force: that of the third cycle of the first run of a typical device, or as stated by the user
    nominal_kN: float
    nominal_words: str  # what it is, with its speed
    force: SlidingForceBounds  # what new devices deliver
    age: Environment  # corrosion
    errors: Mapping[str, float] = field(default_factory=dict)  # by side: Monte-Carlo error of a force, as a share


def design_basis(
    result: PopulationResult,
    set_name: str,
    devices: PredictiveDevices,
    stated: tuple[float, str] | None,
    third_mm_s: float,
    reliability: float = SIDES[HIGH],
) -> DesignBasis:
    """Split what is known of a set into the parts that the codes multiply.

    `stated` is the nominal force of the user, kN, and what it is, `third_mm_s` the peak speed of the third cycle.
    """
    force = sliding_force_bounds(devices, tested_devices(result, set_name), reliability)
    own = own_devices(result, set_name, (LOWEST, HIGHEST, THIRD_CYCLE))
    speed = f"at {third_mm_s:.2g} mm/s" if np.isfinite(third_mm_s) else "at a speed that was not tested"
    typical = f"third cycle of a typical device {speed}, first run"
    nominal = (force.third, typical) if stated is None else stated
    errors = {}
    for side, name in ((LOW, LOWEST), (MIDDLE, THIRD_CYCLE), (HIGH, HIGHEST)):
        level = levels_of(reliability)[side]
        ends = {label: device.ordered(name).with_error(level) for label, device in devices.items()}
        value, error = least_favourable(ends, side, own)
        errors[side] = error / value if side != MIDDLE or stated is None else 0.0
    return DesignBasis(*nominal, force, environment(result, set_name), errors)
