"""The numbers of a campaign page: sets side by side, new devices, comparisons. Nothing is drawn here."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from itertools import combinations
from typing import Any

import numpy as np

from shj_bayes.margins.curves import CurveContrast
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.population.hierarchy import ANY_SET, DeviceSet, PopulationResult
from shj_bayes.population.predict import (
    RUN_FORCES,
    SECOND_RUN,
    LoopBand,
    loop_band,
    new_device,
    new_device_table,
    sets_suffice,
)
from shj_bayes.population.quantities import LEVELS, QUANTITIES

MEANING = {
    "Fy": "sliding force at standstill, first run",
    SECOND_RUN: "sliding force at standstill, second run",
    "ratio": "second run / first run",
    **{force: f"sliding force at standstill, run {force[-1]}" for force in RUN_FORCES if force != SECOND_RUN},
    **{ratio: f"run {ratio[-1]} / first run" for ratio in RUN_FORCES.values() if ratio != "ratio"},
    "K": "initial stiffness",
    "gamma": "speed coefficient 1/dep",
    "beta": "sharpness of the knee",
}
SHOWN = ("Fy", *RUN_FORCES, *RUN_FORCES.values(), "K", "gamma")
MAX_MATRIX, MAX_PAIRS, MAX_LOOPS = 20, 12, 16
NEVER = "a set never tested"
Interval = tuple[float, float, float]


@dataclass(frozen=True)
class SetBand:
    """A new device of one set in one quantity."""

    set_name: str
    n_devices: int  # tested devices that give the quantity
    unit: str
    band: Interval  # 5, 50 and 95 % of a new device
    others: Mapping[str, tuple[float, float]] = field(repr=False)  # the 90 % band under each other prior of the spread
    # the tested devices; low and high equal the middle where only a point is known
    devices: tuple[tuple[str, Interval], ...] = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the set in words."""
        return name_of(self.set_name)

    @property
    def widest(self) -> tuple[float, float]:
        """Band that holds the band under every prior."""
        ends = [(self.band[0], self.band[2]), *self.others.values()]
        return min(low for low, _ in ends), max(high for _, high in ends)


@dataclass(frozen=True)
class Quotient:
    """A typical device of one set over that of another: 5, 50, 95 %; settled when every prior gives the direction."""

    band: Interval
    settled: bool


def name_of(set_name: str) -> str:
    """Name of a set in words."""
    return NEVER if set_name == ANY_SET else set_name


def set_bands(
    result: PopulationResult, intervals: Mapping[tuple[str, str], Mapping[str, Interval]] | None = None
) -> dict[str, tuple[SetBand, ...]]:
    """Bands of a new device of every set, by quantity in the order of `SHOWN`.

    The last band of each is that of a set never tested, where enough were tested to say. `intervals` are 90 % intervals
    of the tested devices; their points stand where it says nothing.
    """
    table = new_device_table(result)
    groups = {group.name: group for group in result.sets}
    if not sets_suffice(len(result.sets)):
        table = table[table["set"] != ANY_SET]
    out: dict[str, tuple[SetBand, ...]] = {}
    for quantity in SHOWN:
        rows = table[table["quantity"] == quantity].to_dict("records")
        if rows:
            out[quantity] = tuple(
                _band(row, groups.get(str(row["set"])), intervals or {}, result.other_priors) for row in rows
            )
    return out


def _band(
    row: Mapping[Any, Any],
    group: DeviceSet | None,
    intervals: Mapping[tuple[str, str], Mapping[str, Interval]],
    priors: Iterable[str],
) -> SetBand:
    quantity = str(row["quantity"])
    devices = []
    for index, name in enumerate(group.devices if group else ()):
        assert group is not None
        known = intervals.get((group.name, name), {}).get(quantity)
        point = known or _point(group, index, quantity)
        if point is not None:
            devices.append((name, point))
    return SetBand(
        str(row["set"]),
        int(row["n_devices"]),
        str(row["unit"]),
        (float(row["q05"]), float(row["q50"]), float(row["q95"])),
        {label: (float(row[f"q05_{label}"]), float(row[f"q95_{label}"])) for label in priors},
        tuple(devices),
    )


def _point(group: DeviceSet, index: int, quantity: str) -> Interval | None:
    """Point value of a device in natural units; None where it gives none."""
    if quantity in RUN_FORCES:
        parts = [_point(group, index, part) for part in ("Fy", RUN_FORCES[quantity])]
        value = float(np.prod([part[1] for part in parts if part])) if all(parts) else np.nan
    else:
        points = group.points.get(quantity, ())
        value = float(QUANTITIES[quantity].natural(points[index])) if index < len(points) else np.nan
    return (value, value, value) if np.isfinite(value) else None


def pairs(result: PopulationResult) -> tuple[tuple[str, str], ...]:
    """Pairs of sets worth a sentence: those that differ in one respect only; all pairs when nothing is said of them."""
    sets = result.sets
    apart = {
        (a.name, b.name): sum(getattr(a.tags, f.name) != getattr(b.tags, f.name) for f in fields(a.tags))
        for a, b in combinations(sets, 2)
    }
    fewest = 1 if any(apart.values()) else 0
    # What is treated is named first, so that a sentence reads "corroded against not corroded"; large sets come first.
    size = {group.name: len(group.devices) for group in sets}
    chosen = [(b, a) for (a, b), n in apart.items() if n == fewest]
    return tuple(sorted(chosen, key=lambda pair: -min(size[pair[0]], size[pair[1]]))[:MAX_PAIRS])


def curve_words(curve: CurveContrast) -> str:
    """Say how the force of two sets changes along a coordinate, value by value and all values together."""
    title, unit = coordinate_named(curve.coordinate).title, "" if curve.unit == "1" else f" {curve.unit}"
    said = "; ".join(
        f"{middle:+.1f} % ({low:+.1f} to {high:+.1f}) at {at:.3g}{unit}"
        for at, (low, middle, high) in zip(curve.at, curve.percent, strict=True)
    )
    return (
        f"{curve.set_a} over {curve.set_b} along {title}, both as 1 at {curve.reference:.3g}{unit}: the force of a "
        f"typical device differs by {said}. That the curves are not the same has a probability of "
        f"{curve.probability_other:.2f} under the least favourable assumption on the spread; that they differ by less "
        f"than {100 * curve.rope:.0f} % at all of these values one of {curve.probability_rope:.2f} ({curve.n_a} and "
        f"{curve.n_b} devices)."
    )


def force_matrix(result: PopulationResult) -> list[list[Quotient | None]]:
    """Sliding force of a typical device of the row's set over that of the column's; None on the diagonal.

    Empty when there are too many sets to show, or one.
    """
    n = len(result.sets)
    if not 2 <= n <= MAX_MATRIX or "Fy" not in result.posteriors:
        return []
    levels = [result.posteriors["Fy"].mu, *(fits["Fy"].mu for fits in result.other_priors.values() if "Fy" in fits)]

    def quotient(i: int, j: int) -> Quotient:
        low, middle, high = (float(v) for v in np.exp(np.quantile(levels[0][:, i] - levels[0][:, j], LEVELS)))
        ends = [np.quantile(mu[:, i] - mu[:, j], (LEVELS[0], LEVELS[2])) for mu in levels]
        return Quotient((low, middle, high), not any(a < 0 < b for a, b in ends))

    return [[quotient(i, j) if i != j else None for j in range(n)] for i in range(n)]


def loop_bands(result: PopulationResult, amplitude_mm: float, peak_speed_mm_s: float) -> tuple[LoopBand, ...]:
    """Band of the loop of a new device of each set, both runs where both are known, of a set never tested last."""
    out = []
    untested = (ANY_SET,) if sets_suffice(len(result.sets)) else ()
    for name in (*result.set_names[:MAX_LOOPS], *untested):
        device = new_device(result, name)
        if not all(q in device.draws for q in ("K", "Fy", "beta", "gamma")):
            continue
        for run in (1, 2) if SECOND_RUN in device.draws else (1,):
            out.append(loop_band(device, amplitude_mm=amplitude_mm, peak_speed_mm_s=peak_speed_mm_s, run=run))
    return tuple(out)
