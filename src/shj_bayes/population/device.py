"""Devices of a population: what is known of each, from fits, from rounded numbers and from the paper's tables."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from pathlib import Path

import numpy as np

from shj_bayes._util.files import damage_told, shipped
from shj_bayes.errors import PopulationError, ShjError
from shj_bayes.model.law import variant_named
from shj_bayes.population.quantities import (
    QUANTITIES,
    QuantityLikelihood,
    gamma_of_dep,
    of_draws,
    ratio_of,
    rounded,
    to_decade,
    to_step,
)
from shj_bayes.results.device import DeviceResult


@dataclass(frozen=True)
class Tags:
    """What makes a set what it is; the contrasts between sets are built on these."""

    coating: str = "none"  # "none" when uncoated
    coverage_percent: float | None = None  # share of the sliding surface that is coated; None where no share applies
    corroded: bool = False  # after the salt-water cycles
    material: str = ""  # shim material, empty when not stated


NO_TAGS = Tags()


@dataclass(frozen=True)
class DeviceEstimate:
    """What is known about one device."""

    name: str  # unique inside its set
    set_name: str  # the set of nominally identical devices it belongs to
    # per quantity (K, Fy, ratio, gamma, beta); what is missing is simply not known for this device
    measurements: Mapping[str, QuantityLikelihood] = field(repr=False)
    tags: Tags = Tags()  # the same for all devices of a set

    def __post_init__(self) -> None:
        """Refuse nameless devices, unknown quantities and devices that say nothing."""
        if not self.name.strip() or not self.set_name.strip():
            raise PopulationError(f"a device needs a name and a set; got {self.name!r} in set {self.set_name!r}")
        if not self.measurements:
            raise PopulationError(
                f"device {self.name!r} gives none of K, Fy, ratio, gamma, beta; leave it out or give one of them"
            )

    def point(self, name: str) -> float:
        """Point value on the pooled scale, NaN when this device does not give the quantity."""
        known = self.measurements.get(name)
        return np.nan if known is None else known.point

    def error(self, name: str) -> float:
        """How well the point value is known: standard deviation of the likelihood, pooled scale; NaN without it."""
        known = self.measurements.get(name)
        return np.nan if known is None else known.centre_and_sd[1]


def sets_of(devices: Sequence[DeviceEstimate]) -> dict[str, tuple[DeviceEstimate, ...]]:
    """Group devices by set, in the order in which the sets first appear.

    `PopulationError` if there is no device, a name is used twice in a set, or devices of a set carry different tags.
    """
    if not devices:
        raise PopulationError("no device given; a population needs at least one")
    grouped: dict[str, list[DeviceEstimate]] = {}
    seen: set[tuple[str, str]] = set()
    for device in devices:
        if (device.set_name, device.name) in seen:
            raise PopulationError(
                f"two devices of set {device.set_name!r} are called {device.name!r}; give each its own name"
            )
        seen.add((device.set_name, device.name))
        group = grouped.setdefault(device.set_name, [])
        if group and group[0].tags != device.tags:
            raise PopulationError(
                f"devices {group[0].name!r} and {device.name!r} share set {device.set_name!r} but not its tags "
                f"({group[0].tags} against {device.tags}); correct the tags or split the set"
            )
        group.append(device)
    return {name: tuple(group) for name, group in grouped.items()}


@dataclass(frozen=True)
class RangeTested:
    """Range of amplitudes and speeds that every device of a population went through."""

    # smallest_mm, largest_mm: amplitudes (half strokes), mm
    smallest_mm: float
    largest_mm: float
    # slowest_mm_s, fastest_mm_s: smallest and largest peak speed of a cycle, mm/s; within a stroke every speed from 0
    # to the peak occurs
    slowest_mm_s: float
    fastest_mm_s: float
    # reversal rule of the law that the devices were fitted with ("published" or "continuous")
    variant: str = "published"
    source: str = ""  # where the range comes from

    def __post_init__(self) -> None:
        """Refuse ranges that are empty or not finite."""
        numbers = (self.smallest_mm, self.largest_mm, self.slowest_mm_s, self.fastest_mm_s)
        ordered = 0 < self.smallest_mm <= self.largest_mm and 0 < self.slowest_mm_s <= self.fastest_mm_s
        if not (np.isfinite(numbers).all() and ordered):
            raise PopulationError(
                f"tested range {self.smallest_mm:g} to {self.largest_mm:g} mm, {self.slowest_mm_s:g} to "
                f"{self.fastest_mm_s:g} mm/s: every number must be above zero and the first no larger than the second"
            )

    @property
    def one_speed(self) -> bool:
        """Whether all cycles had nearly the same peak speed, so that speed and position cannot be told apart."""
        return self.fastest_mm_s < 1.5 * self.slowest_mm_s

    def holds_speed(self, speed_mm_s: float) -> bool:
        """Whether sliding at that speed happened in the tests."""
        return 0 < speed_mm_s <= 1.01 * self.fastest_mm_s


PUBLISHED = RangeTested(5.94, 95.0, 9.8, 10.25, "published", "Table 1 of the paper")
"""Six amplitudes at nearly one peak speed: 2 pi f A is 9.80 to 10.25 mm/s in every block."""


def common(ranges: Sequence[RangeTested]) -> RangeTested | None:
    """Range that all devices went through; None where there is none.

    The rule is the smaller of the upper ends: a force at a speed that only some devices saw would rest on fewer
    devices than the sheet says.
    """
    if not ranges:
        return None
    low = max(r.smallest_mm for r in ranges), max(r.slowest_mm_s for r in ranges)
    high = min(r.largest_mm for r in ranges), min(r.fastest_mm_s for r in ranges)
    variants = {r.variant for r in ranges}
    if low[0] > high[0] or len(variants) > 1:
        return None
    return RangeTested(low[0], high[0], min(low[1], high[1]), high[1], variants.pop(), "the recordings of every device")


def device_from_fit(folder: Path, name: str, set_name: str, tags: Tags = NO_TAGS) -> DeviceEstimate:
    """Read one finished fit as a device of a population.

    Draws of K, Fy, beta, gamma and ratio, as far as the fit has them, with the density of the prior they were sampled
    under, so that the population does not count that prior once for each device. `PopulationError` if the prior of a
    quantity shaped its draws more than the recording did.
    """
    with damage_told(f"fit.json or posterior.nc in {folder.name}", PopulationError):
        fit, known = DeviceResult.read(folder), {}
        for q in (q for q in QUANTITIES if q in fit.draws):
            values, prior = fit.draws[q], fit.laws[q]
            # On a logarithmic scale a density of the value itself gains the factor d value / d log value.
            density = prior.log_density(values) + (np.log(values) if QUANTITIES[prior.name].logarithmic else 0.0)
            try:
                known[q] = of_draws(q, values, density)
            except PopulationError as error:
                raise PopulationError(f"device {name!r}: {error}") from error
        return DeviceEstimate(name, set_name, known, tags)


def tested_by_fit(folder: Path) -> RangeTested | None:
    """Amplitudes and peak speeds of a device's recordings; None where its files do not hold them.

    From the complete half-cycles: the first and last of each run may be cut short.
    """
    try:
        fit = DeviceResult.read(folder)
        variant = variant_named(fit.record.model.variant)
        motions = [history.motion for history in fit.histories]
    except (ShjError, KeyError, TypeError, ValueError):
        return None
    cut = [(motion, slice(a, b)) for motion in motions for a, b in pairwise(motion.start[1:-1])]
    amplitudes = [0.5 * float(np.ptp(motion.displacement_mm[part])) for motion, part in cut]
    peaks = [float(np.quantile(motion.speed_mm_s[part], 0.98)) for motion, part in cut]
    if not amplitudes or min(amplitudes) <= 0 or min(peaks) <= 0:
        return None
    # A recording on noisy displacement has half-cycles of different size; 2 % at either end is not a range.
    low, high = np.quantile(amplitudes, (0.02, 0.98)), np.quantile(peaks, (0.1, 0.9))
    return RangeTested(float(low[0]), float(low[1]), float(high[0]), float(high[1]), variant, folder.name)


DEVICE_TABLES = (3, 4, 5, 6, 7)
Value = float | int | tuple[float, ...] | tuple[int, ...]


class Holding(StrEnum):
    """Whether the tables of the paper bear out what its text says."""

    YES = "holds"
    PARTLY = "holds in part"
    NO = "does not hold"
    OPEN = "not settled"


@dataclass(frozen=True)
class Claim:
    """One statement of the paper against its own numbers."""

    id: str  # short name
    claim: str  # what the paper says, in our words
    verdict: Holding  # what its tables say
    values: Mapping[str, Value]  # the figures behind the verdict
    sentence: str  # the same in plain words


@dataclass(frozen=True)
class PublishedRow:
    """One device row of Tables 3-7."""

    table: int  # 3 to 7
    row: str  # as printed, tidied
    set_name: str  # the set it belongs to
    tags: Tags  # material, coating, coverage, corroded
    values: Mapping[tuple[str, int], float]  # K kN/mm, Fy kN, beta 1, dep mm/s; runs 1 and 2
    steps: Mapping[str, float]  # rounding step per quantity; decades for beta

    @property
    def ratio(self) -> float:
        """Sliding force of the second run over that of the first, as printed."""
        return self.values["Fy", 2] / self.values["Fy", 1]

    @property
    def gamma(self) -> float:
        """1/dep, s/mm, as printed."""
        return 1.0 / self.values["dep", 1]

    def device(self) -> DeviceEstimate:
        """Turn the row into a device whose values are known up to their rounding."""
        value, step = self.values, self.steps
        first, second = (to_step(value["Fy", run], step["Fy"]) for run in (1, 2))
        known = {
            "K": rounded("K", to_step(value["K", 1], step["K"])),
            "Fy": rounded("Fy", first),
            "gamma": rounded("gamma", gamma_of_dep(value["dep", 1], step["dep"])),
            "beta": rounded("beta", to_decade(value["beta", 1], step["beta"])),
            "ratio": ratio_of(second, first),
        }
        return DeviceEstimate(f"T{self.table} {self.row}", self.set_name, known, self.tags)


def read_table(number: int) -> list[dict[str, str]]:
    """Rows of ``data/published/table<number>.csv``, cells as text by column; `PopulationError` where there is none."""
    if number not in range(1, 8):
        raise PopulationError(f"the paper has Tables 1 to 7, not {number}")
    with shipped("data", "published", f"table{number}.csv").open(encoding="utf-8", newline="") as handle:
        return list(csv.DictReader(handle))


def published_rows() -> tuple[PublishedRow, ...]:
    """Return the 25 device rows of Tables 3-7; rows that repeat another table are left out."""
    found: dict[tuple[int, str], list[dict[str, str]]] = {}
    for number in DEVICE_TABLES:
        for line in read_table(number):
            if not line["repeats_table"]:
                found.setdefault((number, line["row"]), []).append(line)
    return tuple(
        PublishedRow(
            number,
            row,
            head["set"],
            Tags(
                coating=head["coating"],
                coverage_percent=float(head["coverage_percent"]) if head["coverage_percent"] else None,
                corroded=head["corroded"] == "true",
                material=head["material"],
            ),
            {(line["quantity"], int(line["run"])): float(line["value"]) for line in (head, *others)},
            {line["quantity"]: float(line["rounding_step"]) for line in (head, *others)},
        )
        for (number, row), (head, *others) in found.items()
    )


def published_devices() -> tuple[DeviceEstimate, ...]:
    """Return the 25 devices of Tables 3-7, each value known up to its rounding.

    Five sets of one device (shim materials, Table 3), five of two (coatings, Tables 4 and 5) and five of
    two (corroded coatings, Tables 6 and 7).
    """
    return tuple(row.device() for row in published_rows())
