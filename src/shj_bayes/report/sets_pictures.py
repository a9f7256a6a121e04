"""The pictures of a population, each with its sentence. Importing this imports matplotlib."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from shj_bayes.margins.curves import CurveContrast
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.population.loops import LoopBand
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.predict import RUN_FORCES, SECOND_RUN
from shj_bayes.report import sets
from shj_bayes.report.figures import population as figures
from shj_bayes.report.page import Picture

TITLES = {
    "Fy": "Sliding force of the first run",
    SECOND_RUN: "Sliding force of the second run",
    "ratio": "Second run over first run",
    **{force: f"Sliding force of run {force[-1]}" for force in RUN_FORCES if force != SECOND_RUN},
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
