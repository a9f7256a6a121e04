"""Coating sets: what the page of a campaign shows of them."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.margins.curves import CurveContrast
from shj_bayes.margins.row import BANDS
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.population.compare import Direction, compare
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.predict import (
    RUN_FORCES,
    SECOND_RUN,
    LoopBand,
    dep_words,
    how_wide,
    never_tested_words,
    sets_suffice,
)
from shj_bayes.report import sets, words
from shj_bayes.report.campaign_physics import NUMBERS
from shj_bayes.report.figures import population as figures
from shj_bayes.report.page import Picture
from shj_bayes.results.device import DeviceResult

TITLES = {
    "Fy": "Sliding force at standstill, first run",
    SECOND_RUN: "Sliding force at standstill, second run",
    "ratio": "Second run over first run",
    **{force: f"Sliding force at standstill, run {force[-1]}" for force in RUN_FORCES if force != SECOND_RUN},
    **{ratio: f"Run {ratio[-1]} over first run" for ratio in RUN_FORCES.values() if ratio != "ratio"},
    "K": "Initial stiffness",
    "gamma": "Speed coefficient",
}


def draw(
    result: PopulationResult,
    bands: Mapping[str, tuple[sets.SetBand, ...]],
    motion: tuple[float, float],
    curves: Sequence[CurveContrast] = (),
) -> dict[str, Any]:
    """All pictures of a population by place; `motion` is the amplitude, mm, and the peak speed, mm/s, of the loops."""
    return {
        "first": _bands(bands, "Fy") if "Fy" in bands else None,
        "bands": [{"quantity": q, "picture": _bands(bands, q)} for q in bands if q != "Fy"],
        "loops": _loops(sets.loop_bands(result, *motion)),
        "curves": [_apart(curve) for curve in curves],
    }


def _bands(bands: Mapping[str, tuple[sets.SetBand, ...]], quantity: str) -> Picture:
    rows = bands[quantity]
    unit = "no unit" if rows[0].unit == "1" else rows[0].unit
    caption = _ends(rows)
    if quantity == "Fy":
        caption = (
            "Dots are tested devices; how many stands behind the name of the set. The blue bar is the 90 % interval "
            "of a new device of that set, its upright line the median."
        )
    if quantity == "gamma":
        caption += " 0 means no dependence on speed; a band on both sides of 0 leaves dep = 1/gamma open."
    low, high = figures.span(rows)
    if any(row.widest[0] < low or row.widest[1] > high for row in rows):
        caption += " Lines that end in an arrow run off the sheet: hardly anything is known there."
    return Picture(
        figures.bands(rows, f"{sets.MEANING[quantity]} ({unit})"),
        f"{TITLES[quantity]} of every set: the tested devices, and the band in which a new device is expected.",
        caption,
        TITLES[quantity],
        wide=True,
    )


def _ends(rows: tuple[sets.SetBand, ...]) -> str:
    """Say which sets lie at the ends, and which is known least."""
    unit = "" if rows[0].unit == "1" else f" {rows[0].unit}"
    least, most = min(rows, key=lambda row: row.band[1]), max(rows, key=lambda row: row.band[1])
    widest = max(rows, key=lambda row: row.band[2] - row.band[0])
    low, _, high = (f"{value:.3g}" for value in widest.band)
    text = f"Widest band: {widest.name}, {low} to {high}{unit}."
    if least is most:
        return f"Median: {least.band[1]:.3g}{unit}. {text}"
    return f"Medians from {least.band[1]:.3g}{unit} ({least.name}) to {most.band[1]:.3g}{unit} ({most.name}). {text}"


def _loops(bands: tuple[LoopBand, ...]) -> list[dict[str, Any]]:
    """Loops of each set, of all its runs."""
    found = groupby(bands, key=lambda band: band.set_name)
    return [
        {"address": figures.loop(parts), "name": sets.name_of(name), "runs": parts}
        for name, parts in ((name, list(group)) for name, group in found)
    ]


def _apart(curve: CurveContrast) -> dict[str, Any]:
    title = coordinate_named(curve.coordinate).title
    return {"address": figures.apart(curve), "of": curve, "title": title, "words": sets.curve_words(curve)}


def population_content(
    result: PopulationResult,
    intervals: Mapping[tuple[str, str], Mapping[str, sets.Interval]],
    motion: tuple[float, float],
    curves: Sequence[CurveContrast] = (),
    forces: PopulationResult | None = None,
) -> dict[str, Any]:
    """Everything about the sets, plain values and pictures; `forces` are those that the devices made, pooled."""
    bands = sets.set_bands(result, intervals)
    amplitude, speed = motion
    if forces is not None and forces.set_names != result.set_names:
        forces = None  # not every set gives them
    names = [q for q in sets.FORCES if forces is not None and q in forces.posteriors]
    names += [q for q in bands if q in result.posteriors]
    return {
        "quantities": [{"name": q, "meaning": sets.MEANING[q], "unit": rows[0].unit} for q, rows in bands.items()],
        "table": _table(bands),
        **draw(result, bands, motion, curves),
        "motion": f"{words.short(amplitude)} mm at a peak speed of {words.short(speed)} mm/s",
        "wide": [how_wide(result, row.set_name) for row in bands.get("Fy", ())],
        "untested": "" if sets_suffice(len(result.sets)) else never_tested_words(len(result.sets)),
        "few": _few(result),
        "matrix": sets.force_matrix(forces or result),
        "of_forces": forces is not None,
        "compared": [{"name": q, "meaning": sets.MEANING[q]} for q in names],
        "contrasts": [_contrast(a, b, forces, result) for a, b in sets.pairs(result)],
        "priors": [
            {"name": name, "source": prior.source} for name, prior in result.priors.items() if name in result.posteriors
        ],
        "result": result,
    }


def delivered(record: Mapping[str, Any]) -> dict[str, dict[str, dict[str, str]]]:
    """Plateau force of a new device in the tests, by set, quantity (plateau; plateau_2 of run 2) and side.

    `record` is the content of ``margins.json``.
    """
    out: dict[str, dict[str, dict[str, str]]] = {}
    for row in record.get("margins", ()):
        if row["method"] == BANDS and row["quantity"] in ("plateau", "plateau_2"):
            own = out.setdefault(row["set"], {}).setdefault(row["quantity"], {})
            own[row["side"]] = words.digits(row["value"], row.get("monte_carlo_error", 0.0))
    return out


def tested_motion(folder: Path) -> tuple[float, float] | None:
    """Largest amplitude, mm, and peak speed, mm/s, of a fitted device; None where its files cannot be read."""
    try:
        samples = DeviceResult.read(folder).samples
        x, speed = samples["displacement_mm"], samples["speed_mm_s"]
    except (ShjError, KeyError):
        return None
    amplitude, peak = 0.5 * float(np.ptp(x)), float(np.quantile(speed, 0.99))
    return (amplitude, peak) if amplitude > 0 and peak > 0 else None


def _table(bands: Mapping[str, tuple[sets.SetBand, ...]]) -> list[dict[str, Any]]:
    """One row per set: a new device in every quantity."""
    rows: dict[str, dict[str, Any]] = {}
    for quantity, of_sets in bands.items():
        for band in of_sets:
            head = {"set": band.set_name, "name": band.name, "n": band.n_devices, "cells": {}}
            row = rows.setdefault(band.set_name, head)
            low, middle, high = band.band
            row["n"] = max(row["n"], band.n_devices)
            # Band of gamma as dep, short enough for a cell.
            dep = "dep open" if low <= 0 <= high else f"dep {dep_words(low, high)}"
            dep = dep if quantity == "gamma" else ""
            row["cells"][quantity] = {"low": low, "middle": middle, "high": high, "dep": dep}
    second = {b.name: f"{100 * b.band[0]:.0f} to {100 * b.band[2]:.0f} %" for b in bands.get("ratio", ())}
    for row in rows.values():
        row["second"] = second.get(row["name"], "")
    return list(rows.values())


def _few(result: PopulationResult) -> str:
    """Say plainly when there are too few devices for a band of their own."""
    counts = [len(group.devices) for group in result.sets]
    if min(counts) >= 6:
        return ""
    few = sum(n <= 2 for n in counts)
    verb = "rests" if few == 1 else "rest"
    tail = f" {few} of the {len(counts)} sets here {verb} on one or two devices." if few and len(counts) > 1 else ""
    return (
        f"{NUMBERS[max(2, min(counts))]} devices are not a band: the next one need not lie between them. The blue "
        "bars are for a new device. They hold how much devices of one set differ, which few devices can hardly tell, "
        "so most of their width comes from the other sets and from assumptions; the thin grey lines show how far other "
        f"assumptions move them.{tail}"
    )


def _contrast(a: str, b: str, forces: PopulationResult | None, result: PopulationResult) -> dict[str, Any]:
    """One pair of sets: a cell for each quantity, and the sentence on the force."""
    cells, sentence = {}, ""
    for c in (c for of in (forces, result) if of is not None for c in compare(of, a, b).contrasts):
        form = ".2f" if c.kind == "quotient" else "+.3g"
        cells[c.quantity] = {
            "text": f"{c.q50:{form}}",
            "range": f"{c.q05:{form}} to {c.q95:{form}}",
            "observed": "" if c.observed is None else f"observed {c.observed:{form}}",
            "settled": c.direction is Direction.SETTLED,
        }
        if c.quantity == (sets.FORCES[0] if forces is not None else "Fy"):
            sentence = sets.contrast_words(c, a, b)
    return {"pair": f"{a} against {b}", "cells": cells, "sentence": sentence}
