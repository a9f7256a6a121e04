"""All margins of a population in one sheet: bands, tests, factors; over every model that a diagnosis leaves open."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins import bands
from shj_bayes.margins.agreement import agreement
from shj_bayes.margins.codes.catalogue import catalogue
from shj_bayes.margins.codes.code import Given
from shj_bayes.margins.delivered import FirstCycles
from shj_bayes.margins.diagnosed import LAW_ALONE
from shj_bayes.margins.outermost import newcomers
from shj_bayes.margins.pair import NONE
from shj_bayes.margins.parts import Parts, parts_of
from shj_bayes.margins.request import PLAIN, Request
from shj_bayes.margins.row import BANDS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sample import SAMPLED, Motion, Sample, common_spread, everything
from shj_bayes.margins.speed_guard import Guard, published_factors
from shj_bayes.margins.spread import NOT_NORMAL, between_sets, of_set
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import sets_suffice

PUBLISHED_LAW = "law as published"
UNEQUAL = 2.0
"""Sets spread unequally when the widest of them is surely (95 %) more than this many times the tightest."""


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
    first_cycles: FirstCycles | None = None,
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
    first_cycles : mapping of str to Bounds, optional
        First over third cycle as measured, by set and for ``ANY_SET``.

    Returns
    -------
    Sheet
    """
    if "Fy" not in result.posteriors:
        raise PopulationError("no device gives the sliding force Fy; there are no margins without it")
    motion = motion_of(result, request)
    cycles = first_cycles or {}
    published = tuple(_rows(result, motion, request, cycles))
    models = {PUBLISHED_LAW: published}
    if diagnosed:
        models = {name: tuple(_rows(other, motion, request, cycles)) for name, other in diagnosed.items()}
    alone = models.get(LAW_ALONE, published)
    rows = _outermost(list(models.values()), alone) if diagnosed else published
    # Of a set never tested the files keep numbers that are mostly assumption until enough sets were tested.
    spoken = (*result.set_names, ANY_SET) if sets_suffice(len(result.sets)) else result.set_names
    compared = agreement([row for row in rows if row.set_name in spoken])
    warnings = (*compared.contradictions, *_warnings(result, motion, request), compared.words)
    return Sheet(rows, motion, warnings, tuple(words), tuple(models))


def _rows(
    result: PopulationResult, motion: Motion | None, request: Request, first_cycles: FirstCycles
) -> Iterator[Margin]:
    by_set = everything(result, motion)
    common = {q: common_spread([s[q] for s in by_set.values() if q in s]) for q in SAMPLED}
    known = [*result.set_names, ANY_SET]
    for name in known:
        devices = newcomers(result, name)
        nominal = request.nominal_of(name)
        parts = parts_of(result, name, devices, motion, nominal, first_cycles.get(name, NONE))
        given = _given(name, by_set, common, parts, request)
        found = list(bands.of_set(result, name, devices, given.devices, motion))
        found += [row for code in catalogue() for row in code.rows(given)]
        yield from found
        yield from (_degradation(row) for row in found if row.quantity == "ratio" and row.method != BANDS)


def _given(
    name: str,
    by_set: Mapping[str, dict[str, Sample]],
    common: Mapping[str, tuple[float, int]],
    parts: Parts,
    request: Request,
) -> Given:
    """Draw up what the codes are given of one set; of a set never tested, the sets as the sample."""
    if name != ANY_SET:
        samples = by_set[name]
        spreads = {q: of_set(sample, common[q]) for q, sample in samples.items()}
        return Given(name, samples, spreads, {q: s.n for q, s in samples.items()}, parts, request)
    together = {q: [s[q] for s in by_set.values() if q in s] for q in SAMPLED}
    clustered = {q: between_sets(of_sets) for q, of_sets in together.items() if of_sets}
    return Given(
        name,
        {q: sample for q, (sample, _) in clustered.items()},
        {q: ways for q, (_, ways) in clustered.items()},
        {q: sum(s.n for s in together[q]) for q in clustered},
        parts,
        request,
    )


def _degradation(row: Margin) -> Margin:
    """1 - ratio: the low side of the ratio is the high side of the degradation."""
    side = {LOW: HIGH, HIGH: LOW, MIDDLE: MIDDLE}[row.side]
    return replace(
        row,
        quantity=bands.DEGRADATION,
        side=side,
        value=1.0 - row.value,
        formula=f"1 - ratio; {row.formula}",
        inputs=f"of the ratio: {row.inputs}",
        note=row.note.replace(NOT_NORMAL, "more than all: the normal law does not suit so wide a spread"),
        purpose=bands.LOSS[side],
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
            note = "; ".join(filter(None, (note, f"the less favourable of {listed}")))
        out.append(replace(chosen, note=note, without_diagnosis=alone.get(row.key, math.nan)))
    return tuple(out)


def _warnings(result: PopulationResult, motion: Motion | None, request: Request) -> Iterator[str]:
    tested = result.tested
    if request.v_known is not None:
        yield f"V = {request.v_known:g} of the sliding force is taken as known (EN 1990), because: {request.v_reason}"
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
