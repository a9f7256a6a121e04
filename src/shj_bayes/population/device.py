"""One device of a set, and what is known about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.population.measurement import Measurement, Rounded, of_draws, ratio_of
from shj_bayes.population.quantities import FloatArray


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
    measurements: Mapping[str, Measurement] = field(repr=False)
    tags: Tags = Tags()  # the same for all devices of a set

    def __post_init__(self) -> None:
        """Refuse nameless devices, unknown quantities and devices that say nothing."""
        if not self.name.strip() or not self.set_name.strip():
            raise PopulationError(f"a device needs a name and a set; got {self.name!r} in set {self.set_name!r}")
        if not self.measurements:
            raise PopulationError(
                f"device {self.name!r} gives none of K, Fy, ratio, gamma, beta; leave it out or give one of them"
            )

    @classmethod
    def from_posterior(
        cls,
        name: str,
        set_name: str,
        draws: Mapping[str, FloatArray],
        log_prior: Mapping[str, FloatArray],
        tags: Tags = Tags(),
    ) -> DeviceEstimate:
        """Build a device from its single-device posterior: by quantity, equally weighted draws in natural units.

        `log_prior` is the log density of the single-device prior at those draws, on the pooled scale (densities of log
        K, log Fy, log ratio, log beta and of gamma itself), up to a constant. `PopulationError` if the prior of a
        quantity is missing, does not fit its draws, or shaped them more than the recording did.
        """
        missing = sorted(set(draws) - set(log_prior))
        if missing:
            raise PopulationError(
                f"device {name!r}: the prior density of {', '.join(missing)} is missing; without it the single-device "
                "prior would be counted once per device"
            )
        try:
            known = {q: of_draws(q, draws[q], log_prior[q]) for q in draws}
        except PopulationError as error:
            raise PopulationError(f"device {name!r}: {error}") from error
        return cls(name, set_name, known, tags)

    @classmethod
    def from_table(
        cls,
        name: str,
        set_name: str,
        printed: Mapping[str, Rounded],
        Fy_second: Rounded,
        tags: Tags = Tags(),
    ) -> DeviceEstimate:
        """Build a device from rounded numbers, kN/mm, kN, s/mm, 1; the ratio follows from both runs' Fy."""
        known = {q: value.of(q) for q, value in printed.items()} | {"ratio": ratio_of(Fy_second, printed["Fy"])}
        return cls(name, set_name, known, tags)

    def point(self, name: str) -> float:
        """Point value on the pooled scale, NaN when this device does not give the quantity."""
        known = self.measurements.get(name)
        return np.nan if known is None else known.point

    def error(self, name: str) -> float:
        """How well the point value is known: standard deviation of the likelihood, pooled scale; NaN without it."""
        known = self.measurements.get(name)
        return np.nan if known is None else known.likelihood.centre_and_sd[1]


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
