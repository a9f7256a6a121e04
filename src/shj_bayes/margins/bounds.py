"""Bounds of the sliding force: what a new device delivers, and the band of the tested ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins import row
from shj_bayes.margins.row import BANDS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.model.parameters import base_of
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.predict import NewDevice, new_device, sets_suffice
from shj_bayes.population.quantities import HIGHEST, LEAST, LOWEST, MOST, THIRD_CYCLE, stream
from shj_bayes.population.quantities import quantity as described

SIDES = {LOW: 0.05, MIDDLE: 0.5, HIGH: 0.95}
PURPOSE = {
    LOW: "lower bound: displacement and drift demand, slip at service loads",
    MIDDLE: "best estimate: first analysis",
    HIGH: "upper bound: forces on beam, column, welds and bolts",
}
DEGRADATION = "degradation"
LOSS = {
    LOW: "least loss of sliding force to count on",
    MIDDLE: "best estimate of the loss of sliding force after a first earthquake",
    HIGH: "greatest loss of sliding force to allow for in a second earthquake",
}


def of_set(
    result: PopulationResult, set_name: str, devices: Newcomers, n_devices: Mapping[str, int]
) -> Iterator[Margin]:
    """Bands of a new device of a set: the default prior of the spread, with few devices the outermost of all.

    `n_devices` are those behind each quantity.
    """
    for quantity in (*devices[DEFAULT].draws, DEGRADATION):
        of_ratio = quantity == DEGRADATION
        source = "ratio" if of_ratio else quantity
        if source not in devices[DEFAULT].draws:
            continue
        own = own_devices(result, set_name, (source,))
        count = priors_that_count(tuple(devices), own)
        for side, level in SIDES.items():
            by_prior = {
                label: float(np.quantile(1.0 - device.draws[source] if of_ratio else device.draws[source], level))
                for label, device in devices.items()
            }
            listed = "; ".join(f"{value:.4g} under the prior '{label}'" for label, value in by_prior.items())
            note = f"outermost of {len(count)} priors of the spread: the set has {own} devices of its own"
            head = (set_name, quantity, BANDS, f"new device, {100 * level:.0f} %", side)
            number = (outer(by_prior, side, own), described(source).unit, n_devices.get(source, 0), math.nan)
            origin = (
                "predictive distribution, decision 0004",
                f"{100 * level:.0f} % quantile over draws of set level and spread",
                f"{devices[DEFAULT].draws[source].size} draws; {listed}",
                (LOSS if of_ratio else PURPOSE)[side],
            )
            yield Margin(*head, *number, *origin, note if len(count) > 1 and side != MIDDLE else "")


FEW = 3
DEFAULT = "default"
Newcomers = Mapping[str, NewDevice]
"""New devices of one set by prior of the spread, the default first."""


def newcomers(result: PopulationResult, set_name: str) -> dict[str, NewDevice]:
    """Draw new devices of a set under every prior of the spread that was tried, each read as the tested ones were."""
    return {label: _as_read(new_device(result, set_name, label), result) for label in (DEFAULT, *result.other_priors)}


def _as_read(device: NewDevice, result: PopulationResult) -> NewDevice:
    """Give the draws of design quantities (all of them positive) the error with which those of the set are known."""
    groups = [group for group in result.sets if device.set_name in (ANY_SET, group.name)] or result.sets
    draws = {}
    for q, values in device.draws.items():
        errors = np.concatenate([group.errors.get(q, ()) for group in groups])
        known = errors[np.isfinite(errors)]
        rng = np.random.default_rng(stream(result.seed, "reading", device.set_name, q))
        error = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
        draws[q] = values * np.exp(error * rng.standard_normal(values.size))
    return replace(device, draws=draws)


def own_devices(result: PopulationResult, set_name: str, quantities: Iterable[str]) -> int:
    """Devices of a set that give all of the quantities; for a set never tested so many that the default counts.

    What a set never tested will be follows from all sets together, not from a few devices of its own.
    """
    if set_name == ANY_SET:
        return FEW + 1
    index = result.index(set_name)
    return min(result.fit(q).n_devices[index] for q in quantities if q in result.posteriors)


def priors_that_count(labels: Sequence[str], own: int) -> tuple[str, ...]:
    """Priors of the spread that a band is taken over: the default, with few devices all."""
    return tuple(labels) if own <= FEW else (DEFAULT,)


def outer(by_prior: Mapping[str, float], side: str, own: int) -> float:
    """Least favourable value of the priors that count; the default's for the middle."""
    values = [by_prior[label] for label in priors_that_count(tuple(by_prior), own)]
    return {LOW: min(values), HIGH: max(values)}.get(side, by_prior[DEFAULT])


LOWER, MIDDLE, UPPER = "lower", "middle", "upper"


@dataclass(frozen=True)
class Bound:
    """One rate-free definition of a connection."""

    set_name: str  # the set, or "(any set)"
    bound: str  # "lower", "middle", "upper": which of the three analyses it is for
    # K_kN_mm to beta: stiffness, sliding force, sharpness of the knee of Eq. (1).
    K_kN_mm: float
    force_kN: float
    beta: float
    # stiffness_kN_mm, damping: effective stiffness and damping of the amplitude stated
    stiffness_kN_mm: float
    damping: float
    n_devices: int  # tested devices

    def __post_init__(self) -> None:
        """Refuse what no analysis can take."""
        numbers = (self.K_kN_mm, self.force_kN, self.beta)
        if not (np.isfinite(numbers).all() and min(numbers) > 0):
            raise PopulationError(
                f"{self.set_name}, {self.bound}: stiffness {self.K_kN_mm:g} kN/mm, force {self.force_kN:g} kN and "
                f"sharpness {self.beta:g} must be above zero; test more devices of this set, or leave it out"
            )


def bounds(design: PopulationResult, parameters: PopulationResult, amplitude_mm: float) -> tuple[Bound, ...]:
    """Draw up three bounds of every set, from its pooled design quantities and parameters (for the sharpness).

    Lower: 5 % of the smallest plateau of all runs. Middle: 50 % of the mean plateau of the first run. Upper: 95 % of
    the largest force of all runs. Stiffness 5, 50 and 95 %; sharpness its middle. Effective stiffness and damping are
    those of an elastic-plastic loop of the amplitude: F / A and (2/pi)(1 - F / (K A)).
    """
    out = []
    # No material of a set never tested where its band would be all assumption: an analysis would take it for a result.
    untested = (ANY_SET,) if sets_suffice(len(design.sets)) else ()
    for name in (*design.set_names, *untested):
        devices = newcomers(design, name)
        own = own_devices(design, name, (LOWEST, HIGHEST, "K"))
        force = delivered(devices, own)
        middle = float(np.median(devices[DEFAULT].draws["plateau"]))
        bands = {label: device.band("K") for label, device in devices.items()}
        fit = parameters.fit("beta")
        level = fit.hyper[:, 0] if name == ANY_SET else fit.mu[:, parameters.index(name)]
        beta = float(np.clip(np.exp(np.median(level)), *BETA_RANGE))
        for i, (bound, side, value) in enumerate(
            ((LOWER, row.LOW, force.low), (MIDDLE, row.MIDDLE, middle), (UPPER, row.HIGH, force.high))
        ):
            stiffness = outer({label: band[i] for label, band in bands.items()}, side, own)
            slip = min(value / (stiffness * amplitude_mm), 1.0)
            damping = (2.0 / math.pi) * (1.0 - slip)
            n = devices[DEFAULT].n_devices
            out.append(Bound(name, bound, stiffness, value, beta, value / amplitude_mm, damping, n))
    return tuple(out)


FORCES = (LOWEST, HIGHEST, LEAST, MOST, "plateau", THIRD_CYCLE)
"""Forces that the bounds of all runs must hold, of every run."""


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
class Delivered:
    """Force of a new device of one set, kN."""

    # third_low to third_high: 5, 50 and 95 % of the third cycle of the first run
    third_low: float
    third: float
    third_high: float
    first_low: float  # 5 % of the smallest plateau of the first run
    later_low: float | None  # the same of the later runs; None without any
    # low, high: 5 % of the smallest plateau and 95 % of the largest force of all runs
    low: float
    high: float
    typical: Bounds  # smallest plateau and largest force of a typical device over its third cycle
    ratio: float | None  # second run over first of a typical device, mean plateau

    @property
    def words(self) -> str:
        """What the force does in the test, of a typical device."""
        said = (
            f"smallest plateau {self.typical.low:.3f} and largest force {self.typical.high:.3f} of the third cycle of "
            "the first run"
        )
        return said + ("; no second run" if self.ratio is None else f"; second run / first {self.ratio:.3f}")


def delivered(devices: Newcomers, own: int) -> Delivered:
    """Bound the force of a new device; with few devices of its own (`own`) by the outermost prior of the spread."""

    def bound(side: str, *names: str) -> float:
        level, pick = (0.05, min) if side == LOW else (0.95, max)
        return pick(
            outer({label: float(np.quantile(d.draws[name], level)) for label, d in devices.items()}, side, own)
            for name in names
        )

    main = devices[DEFAULT].draws
    later = tuple(n for n in main if n.startswith(f"{LEAST}_"))
    # Each quantity is pooled by itself: with few devices chance may put a band inside one that it must hold.
    forces = tuple(n for n in main if base_of(n) in FORCES)
    third = main[THIRD_CYCLE]
    moved = [float(np.median(main[name]) / np.median(third)) for name in (LOWEST, HIGHEST)]
    return Delivered(
        third_low=bound(LOW, THIRD_CYCLE),
        third=float(np.median(third)),
        third_high=bound(HIGH, THIRD_CYCLE),
        first_low=bound(LOW, LEAST),
        later_low=bound(LOW, *later) if later else None,
        low=bound(LOW, *forces),
        high=bound(HIGH, *forces),
        typical=Bounds.around(*moved),
        ratio=float(np.median(main["ratio"])) if "ratio" in main else None,
    )
