"""All margins of a population in one sheet: bands, tests, factors; over every model that a diagnosis leaves open."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins import bands, testing
from shj_bayes.margins.factors import factor_rows
from shj_bayes.margins.parts import parts_of
from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sample import SAMPLED, Motion, Sample, common_spread, everything
from shj_bayes.margins.speed_guard import Guard, published_factors
from shj_bayes.population.posterior import ANY_SET, PopulationResult

PUBLISHED_LAW = "law as published"
UNEQUAL = 2.0
"""Sets spread unequally when the widest of them is surely (95 %) more than this many times the tightest."""


@dataclass(frozen=True)
class Request:
    """What the user asked for.

    Parameters
    ----------
    amplitude_mm, speed_mm_s : float or None
        Of the cycle; the largest tested where not given.
    extrapolate : bool
        Speeds beyond the tested ones may be spoken of.
    importance : {"I", "II", "III"}
        Importance class of the structure, for EN 15129.
    nominal_kN : float or None
        Nominal sliding force for phi, phi_o and the bounds; that of a typical device of the set where not given.
    sets : tuple of str
        Sets that are shown and that the nominal force is for; all where empty.
    """

    amplitude_mm: float | None = None
    speed_mm_s: float | None = None
    extrapolate: bool = False
    importance: str = "II"
    nominal_kN: float | None = None
    sets: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a nominal force that is none."""
        if self.nominal_kN is not None and not (math.isfinite(self.nominal_kN) and self.nominal_kN > 0):
            raise PopulationError(f"a nominal sliding force must be above zero; got {self.nominal_kN:g} kN")

    def nominal_of(self, set_name: str) -> float | None:
        """Nominal sliding force stated for a set, kN."""
        return self.nominal_kN if not self.sets or set_name in self.sets else None


PLAIN = Request()


@dataclass(frozen=True)
class Sheet:
    """Margins of a population.

    Parameters
    ----------
    rows : tuple of Margin
        Set by set, quantity by quantity.
    motion : Motion or None
        Cycle of energy and force; None where the tested range is not known.
    warnings : tuple of str
        What to mind, one sentence each.
    diagnoses : tuple of str
        What the diagnoses changed, device by device.
    models : tuple of str
        Models that the margins are taken over.
    """

    rows: tuple[Margin, ...] = field(repr=False)
    motion: Motion | None
    warnings: tuple[str, ...]
    diagnoses: tuple[str, ...] = ()
    models: tuple[str, ...] = (PUBLISHED_LAW,)

    def get(self, set_name: str, quantity: str, kind: str, side: str) -> Margin | None:
        """One margin; None where there is none."""
        key = (set_name, quantity, kind, side)
        return next((row for row in self.rows if row.key == key), None)


def motion_of(result: PopulationResult, request: Request) -> Motion | None:
    """Cycle asked for, checked against what was tested; None where the tested range is not known.

    Raises
    ------
    PopulationError
        If it was not tested and extrapolation was not asked for, or the range is not known but a cycle was asked for.
    """
    tested = result.tested
    if tested is None:
        if request.amplitude_mm is not None or request.speed_mm_s is not None:
            raise PopulationError(
                "this population does not say at which amplitudes and speeds its devices were tested (or they have "
                "none in common), so nothing can be said of a cycle; run the campaign or the tables again"
            )
        return None
    speed = tested.fastest_mm_s if request.speed_mm_s is None else request.speed_mm_s
    amplitude = tested.largest_mm if request.amplitude_mm is None else request.amplitude_mm
    return Motion(amplitude, Guard(tested, speed, request.extrapolate))


def margins(
    result: PopulationResult,
    request: Request = PLAIN,
    *,
    diagnosed: Mapping[str, PopulationResult] | None = None,
    words: Sequence[str] = (),
) -> Sheet:
    """Draw up the margins of a population.

    Parameters
    ----------
    result : PopulationResult
        Fitted with the law alone.
    request : Request
        Cycle and choices.
    diagnosed : mapping of str to PopulationResult, optional
        Populations with the physics that diagnoses found; the least favourable of them counts, and what `result` gives
        stands beside it.
    words : sequence of str
        What the diagnoses found.

    Returns
    -------
    Sheet
    """
    if "Fy" not in result.posteriors:
        raise PopulationError("no device gives the sliding force Fy; there are no margins without it")
    motion = motion_of(result, request)
    published = tuple(_rows(result, motion, request))
    models = {PUBLISHED_LAW: published}
    if diagnosed:
        models = {name: tuple(_rows(other, motion, request)) for name, other in diagnosed.items()}
    rows = _outermost(list(models.values()), published) if diagnosed else published
    return Sheet(rows, motion, tuple(_warnings(result, motion)), tuple(words), tuple(models))


def _rows(result: PopulationResult, motion: Motion | None, request: Request) -> Iterator[Margin]:
    by_set = everything(result, motion)
    common = {q: common_spread([s[q] for s in by_set.values() if q in s]) for q in SAMPLED}
    together = {q: [s[q] for s in by_set.values() if q in s] for q in common}
    by_set[ANY_SET] = {q: _all_as_one(parts) for q, parts in together.items() if parts}
    for name, samples in by_set.items():
        found = list(bands.of_set(result, name, {q: s.n for q, s in samples.items()}, motion))
        for quantity, sample in samples.items():
            spread = common[quantity] if name != ANY_SET else (math.nan, 0)
            known = _known_spread(result, name, quantity, sample)
            ways = testing.spreads(sample, known, spread)
            found += testing.en1990_values(name, quantity, sample, ways)
            found += testing.tolerance_limits(name, quantity, sample, ways)
        found += [_degradation(row) for row in found if row.quantity == "ratio"]
        nominal = request.nominal_of(name)
        words = "typical device" if nominal is None else "stated by the user"
        parts = parts_of(result, name, motion, nominal)
        found += factor_rows(name, parts, samples["Fy"].n if "Fy" in samples else 0, request.importance, words)
        yield from found


def _all_as_one(parts: Sequence[Sample]) -> Sample:
    """All devices of all sets as one sample: a set never tested may be any of them."""
    return Sample(np.concatenate([p.values for p in parts]), float(np.mean([p.floor for p in parts])))


def _known_spread(result: PopulationResult, name: str, quantity: str, sample: Sample) -> float:
    """Spread taken as known beforehand: the middle of the posterior of the set's own, sd of the logarithm."""

    def middle(q: str) -> float:
        fit = result.fit(q)
        if name == ANY_SET:
            return float(np.median(np.hypot(fit.hyper[:, 1], fit.hyper[:, 2])))
        return float(np.median(fit.tau[:, result.index(name)]))

    needed = {"Fy_second": ("Fy", "ratio"), "energy": ("Fy",), "force": ("Fy",)}.get(quantity, (quantity,))
    return max(math.hypot(*(middle(q) for q in needed)), sample.floor)


def _degradation(row: Margin) -> Margin:
    """1 - ratio: the low side of the ratio is the high side of the degradation."""
    side = {LOW: HIGH, HIGH: LOW, MIDDLE: MIDDLE}[row.side]
    kind = {"new device, 5 %": "new device, 95 %", "new device, 95 %": "new device, 5 %"}.get(row.kind, row.kind)
    purpose = {
        LOW: "least loss of sliding force to count on",
        MIDDLE: "best estimate of the loss of sliding force after a first earthquake",
        HIGH: "greatest loss of sliding force to allow for in a second earthquake",
    }[side]
    return replace(
        row,
        quantity="degradation",
        side=side,
        kind=kind,
        value=1.0 - row.value,
        formula=f"1 - ratio; {row.formula}",
        note=row.note.replace(testing.NOT_NORMAL, "more than all: the normal law does not suit so wide a spread"),
        purpose=purpose,
    )


def _outermost(models: Sequence[tuple[Margin, ...]], published: tuple[Margin, ...]) -> tuple[Margin, ...]:
    """Least favourable of the models, row by row, with the value of the law alone beside it."""
    alone = {row.key: row.value for row in published}
    tables = [{row.key: row for row in rows} for rows in models]
    out = []
    for row in models[0]:
        same = [table[row.key] for table in tables if row.key in table]
        values = [r.value for r in same]
        pick = {LOW: np.argmin, HIGH: np.argmax}.get(row.side)
        chosen = same[int(pick(values))] if pick else replace(row, value=float(np.mean(values)))
        note = chosen.note
        if len(values) > 1 and values[0] != values[1]:
            listed = " or ".join(f"{v:.4g}" for v in values)
            note = "; ".join(filter(None, (note, f"the physics is open: {listed}")))
        out.append(replace(chosen, note=note, without_diagnosis=alone.get(row.key, math.nan)))
    return tuple(out)


def _warnings(result: PopulationResult, motion: Motion | None) -> Iterator[str]:
    tested = result.tested
    if motion is not None and tested is not None:
        if motion.guard.beyond:
            yield (
                f"{motion.guard.speed_mm_s:g} mm/s was NOT tested (tested up to {tested.fastest_mm_s:.3g} mm/s). "
                "Energy and force are the spread of laws that agree with the tests and stay bounded. "
                + published_factors(motion.guard.speed_mm_s)
            )
        if tested.one_speed:
            yield (
                f"All cycles had nearly one peak speed ({tested.slowest_mm_s:.3g} to {tested.fastest_mm_s:.3g} mm/s): "
                "speed dependence and a loss of friction away from mid-stroke cannot be told apart; gamma may "
                "be either."
            )
    if not result.converged:
        yield "The calculation of the population has not finished: take these margins as a first look."
    fit = result.fit("Fy")
    several = [i for i, n in enumerate(fit.n_devices) if n > 1]
    if len(several) > 1:
        middle = np.median(fit.tau[:, several], axis=0)
        wide, tight = several[int(np.argmax(middle))], several[int(np.argmin(middle))]
        if np.quantile(fit.tau[:, wide] / fit.tau[:, tight], 0.05) > UNEQUAL:
            yield (
                f"The sets do not spread alike: {result.set_names[wide]} spreads several times as much as "
                f"{result.set_names[tight]}. Margins with the spread common to all sets are too wide for the one and "
                "too narrow for the other; the bands of a new device allow for it."
            )
    few = sum(n < 3 for n in fit.n_devices)
    if few:
        yield (
            f"{few} of {len(fit.n_devices)} sets rest on one or two devices. The smallest and largest of two hold 90 % "
            "of all devices with a confidence of only 1 %: two devices are not a band."
        )
    if "ratio" not in result.posteriors:
        yield "No device has a second run, so nothing is said of a second earthquake."
