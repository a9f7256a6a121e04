"""A margin: its value, where it comes from, what it is for; samples of devices, and the spread between them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from scipy.special import fdtrc

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PopulationError
from shj_bayes.population.hierarchy import DeviceSet
from shj_bayes.population.quantities import quantity

BANDS, TESTING, TOLERANCE, FACTORS = "new device", "EN 1990", "tolerance", "factor"
DESIGN, SPREAD, USE = "design", "spread", "use"
LOW, MIDDLE, HIGH = "low", "middle", "high"
FloatOrNull = Annotated[float, {"type": ["number", "null"]}]  # null in a file where it is NaN
Key = tuple[str, str, str, str]
"""Set, quantity, kind, side."""
V_KNOWN, V_UNKNOWN, V_COMMON, V_BETWEEN = "V known", "V unknown", "V common", "V between sets"
SIGNS = {LOW: -1, HIGH: 1}
LARGEST_LOG = 300.0  # of a limit; two devices that differ widely reach beyond what a number holds
NORMAL, LOGNORMAL = "normal", "lognormal"
NOT_NORMAL = "not above zero: the normal law does not suit so wide a spread; use the lognormal value"
_FLOORED = "the devices agree to the printed digits: the spread is that of rounding"


class Origin(NamedTuple):
    """Where a margin comes from."""

    clause: str
    formula: str  # in words and signs
    inputs: str  # the numbers put into it
    purpose: str  # what it is for
    note: str = ""  # what to mind
    warning: str = ""  # a few words that belong into the same cell as the value wherever it is shown


@dataclass(frozen=True)
class Margin:
    """A margin of one set in one quantity."""

    set_name: str = field(metadata={"key": "set"})  # the set, or "(any set)" for one never tested
    # a design quantity (lowest, highest, least, most, plateau, third, energy; ``_2`` and so on for later runs), ratio,
    # degradation, K; or force, for what bounds the force of all runs
    quantity: str
    method: str  # design, use, new device, EN 1990, tolerance, factor or spread
    kind: str  # what it is, in a few words
    side: str  # "low", "middle", "high": which side of the typical value it bounds
    value: FloatOrNull  # the number; NaN where it cannot be given, with the reason in ``note``
    unit: str  # its unit, "1" for none
    n_devices: int  # devices of the set (of all sets for one never tested)
    # degrees of freedom of the spread; infinity where it is taken as known; NaN where the notion does not apply
    degrees: Annotated[float, {"type": ["number", "string", "null"]}] = field(metadata={"key": "degrees_of_freedom"})
    # clause to purpose: clause, formula in words and signs, the numbers put into it, and what it is for
    clause: str
    formula: str
    inputs: str
    purpose: str
    note: str = ""  # what to mind
    warning: str = ""  # a few words that belong into the same cell as the value wherever it is shown; empty for none
    # standard error of the value from the number of draws, in its unit
    monte_carlo_error: FloatOrNull = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        """Refuse a number without origin."""
        if self.side not in (LOW, MIDDLE, HIGH):
            raise PopulationError(f"a margin is low, middle or high, not {self.side!r}")
        if not (self.clause and self.formula and self.purpose and self.unit):
            raise PopulationError(
                f"the margin {self.kind!r} of {self.quantity} lacks a clause, formula, unit or purpose"
            )

    @property
    def key(self) -> Key:
        """What it is found by."""
        return self.set_name, self.quantity, self.kind, self.side


@dataclass(frozen=True)
class Sample:
    """Devices of one set in one quantity."""

    values: FloatArray = field(repr=False)  # shape (n,): natural unit, above zero
    floor: float  # standard deviation of the logarithm that rounding or measurement alone would make

    def __post_init__(self) -> None:
        """Refuse values without a logarithm."""
        if not (np.all(np.isfinite(self.values)) and np.all(self.values > 0)):
            raise PopulationError(f"a sample must be finite and above zero; got {self.values}")

    @property
    def n(self) -> int:
        """Devices."""
        return int(self.values.size)

    @cached_property
    def mean(self) -> float:
        """Mean, natural unit."""
        return float(self.values.mean())

    @cached_property
    def mean_log(self) -> float:
        """Mean of the logarithm."""
        return float(np.log(self.values).mean())

    @cached_property
    def sd_log(self) -> float:
        """Standard deviation of the logarithm, not below what rounding or measurement alone makes; NaN for one."""
        return max(float(np.log(self.values).std(ddof=1)), self.floor) if self.n > 1 else math.nan

    @cached_property
    def variation(self) -> float:
        """Coefficient of variation, with the same floor; NaN for one."""
        return max(float(self.values.std(ddof=1)) / self.mean, self.floor) if self.n > 1 else math.nan


def samples(group: DeviceSet) -> dict[str, Sample]:
    """Every quantity of the devices of a set, as far as they give it."""
    out = {}
    for q, points in group.points.items():
        values = np.array(points)
        known = np.isfinite(values)
        if known.any():
            errors = np.nan_to_num(group.errors.get(q, (0.0,) * values.size))[known]
            out[q] = Sample(quantity(q).natural(values[known]), float(np.sqrt(np.mean(np.square(errors)))))
    return out


def common_spread(of_sets: list[Sample]) -> tuple[float, int]:
    """Pool the standard deviation of the logarithm common to several sets, and its degrees of freedom (0: none)."""
    several = [s for s in of_sets if s.n > 1]
    degrees = sum(s.n - 1 for s in several)
    if not degrees:
        return math.nan, 0
    squares = sum(float(np.sum((np.log(s.values) - s.mean_log) ** 2)) for s in several)
    floor = math.sqrt(sum(s.floor**2 * (s.n - 1) for s in several) / degrees)
    return max(math.sqrt(squares / degrees), floor), degrees


UNLIKE = 0.05
"""Level at which a set counts as spreading more than the others, allowing for the number of sets."""
MORE = "spreads more than the other sets"


def spreading_more(of_sets: Mapping[str, Sample]) -> dict[str, tuple[float, float]]:
    """Find sets whose devices differ more than those of the others together: how many times as much, p of the F test.

    The p-value allows for the number of sets. The farthest is taken out before the others are looked at again, so that
    two wide sets do not hide each other.
    """
    left = {name: sample for name, sample in of_sets.items() if sample.n > 1}
    n, out = len(left), dict[str, tuple[float, float]]()
    while len(left) > 1:
        found = []
        for name, sample in left.items():
            sd, degrees = common_spread([other for key, other in left.items() if key != name])
            times = sample.sd_log / sd if sd else math.inf
            found.append((n * float(fdtrc(sample.n - 1, degrees, times**2)), times, name))
        p, times, name = min(found)
        if p > UNLIKE:
            break
        out[name] = times, p
        del left[name]
    return out


@dataclass(frozen=True)
class Spread:
    """Where the spread of a margin comes from."""

    name: str  # "V known", "V unknown", "V common" or "V between sets"
    # sd_log, variation: standard deviation of the logarithm; coefficient of variation
    sd_log: float
    variation: float
    degrees: float  # degrees of freedom; infinity where it is taken as known
    n_mean: float  # independent values that the mean is worth: its error is the spread over the root of this
    origin: str  # in words
    note: str = ""  # what to mind
    warning: str = ""  # a few words for the cell of every value that rests on it


def sd_of_log(variation: float) -> float:
    """s_y = sqrt(ln(1 + V^2)) of a coefficient of variation."""
    return math.sqrt(math.log1p(variation**2))


def variation_of_log(sd_log: float) -> float:
    """V = sqrt(exp(s_y^2) - 1) of a standard deviation of the logarithm."""
    return math.sqrt(math.expm1(sd_log**2))


def known(sample: Sample, variation: float, reason: str) -> Spread:
    """Take a coefficient of variation as known beforehand, for the reason given.

    The devices tested must not contradict it: where they spread more, the note says so.
    """
    note = ""
    if sample.n > 1 and sample.variation > variation:
        note = f"these devices spread more than the V stated: {sample.variation:.3f} against {variation:g}"
    return Spread(V_KNOWN, sd_of_log(variation), variation, math.inf, sample.n, f"stated, because: {reason}", note)


def of_set(sample: Sample, common: tuple[float, int], warning: str = "") -> tuple[Spread, ...]:
    """Spread of a set: from its own devices, and common to all sets; `warning` is of the latter."""
    out = []
    if sample.n > 1:
        notes = [_FLOORED] if sample.sd_log <= sample.floor else []
        notes += ["two devices hardly tell a spread; use V common"] if sample.n == 2 else []
        known_to = (sample.sd_log, sample.variation, sample.n - 1, sample.n)
        out.append(Spread(V_UNKNOWN, *known_to, "these devices alone", "; ".join(notes)))
    sd, degrees = common
    if degrees:
        origin = "all sets together, each about its mean"
        out.append(Spread(V_COMMON, sd, variation_of_log(sd), degrees, sample.n, origin, warning, warning))
    return tuple(out)


def between_sets(of_sets: Sequence[Sample]) -> tuple[Sample, tuple[Spread, ...]]:
    """Take sets as the sample, for a device of a set never tested: devices of one set are no independent values.

    The sample holds the geometric mean of the devices of each set; of a single set there is no spread. The variance of
    such a device is s_m^2 + (1 - 1/n) s_w^2, with s_m that of the set means, s_w that within sets and n the harmonic
    mean of the devices a set; the mean is that of the set means, with variance s_m^2 / sets (random effects; Mee and
    Owen 1983), and the degrees of freedom are Satterthwaite's.
    """
    means = np.exp([s.mean_log for s in of_sets])
    harmonic = 1.0 / float(np.mean([1.0 / s.n for s in of_sets]))
    floor = math.sqrt(float(np.mean([s.floor**2 / s.n for s in of_sets])))
    sample = Sample(means, floor)
    if sample.n < 2:
        return sample, ()
    within, degrees = common_spread(list(of_sets))
    between = sample.sd_log**2
    inside = (1.0 - 1.0 / harmonic) * within**2 if degrees else 0.0
    total = between + inside
    if total == 0.0:  # one device a set, and all alike: nothing is known of how sets differ
        return sample, ()
    nu = total**2 / (between**2 / (sample.n - 1) + (inside**2 / degrees if degrees else 0.0))
    sd = math.sqrt(total)
    origin = f"{sample.n} set means and the devices about them ({harmonic:.3g} a set)"
    return sample, (
        Spread(V_BETWEEN, sd, variation_of_log(sd), nu, sample.n * total / between if between else math.inf, origin),
    )


def limit(sample: Sample, way: Spread, factor: float, law: str, side: str) -> tuple[float, str, str]:
    """Mean less (plus, on the high side) factor times spread, under a law: value, formula and inputs."""
    sign = SIGNS[side]
    mark = "-" if sign < 0 else "+"
    if law == LOGNORMAL:
        inputs = f"m_y = {sample.mean_log:.4f}, s_y = {way.sd_log:.4f}, k = {factor:.4f}"
        power = min(sample.mean_log + sign * factor * way.sd_log, LARGEST_LOG)
        return math.exp(power), f"exp(m_y {mark} k s_y)", inputs
    inputs = f"m = {sample.mean:.5g}, V = {way.variation:.4f}, k = {factor:.4f}"
    return sample.mean * (1.0 + sign * factor * way.variation), f"m (1 {mark} k V)", inputs


def remarks(way: Spread, value: float) -> str:
    """Say what to mind of a limit."""
    return "; ".join(filter(None, (way.note, NOT_NORMAL if value <= 0 else "")))
