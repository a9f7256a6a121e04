"""The pictures of a diagnosis page, each with its sentence. Importing this imports matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from shj_bayes.report import diagnosis_words as say
from shj_bayes.report import words
from shj_bayes.report.diagnosis_data import DiagnosisData, number
from shj_bayes.report.diagnosis_numbers import (
    N_BINS,
    Map,
    position_travel,
    profile,
    shown_cycle,
    travel_bins,
)
from shj_bayes.report.figures import diagnosis as draw_
from shj_bayes.report.page import Picture

FIRST = 2  # loops on the first screen
MOST = 6  # runs that are drawn
COORDINATES = (
    ("position_mm", "Stroke position", "distance from mid-stroke (mm)"),
    ("speed_mm_s", "Speed", "speed (mm/s)"),
    ("slip_mm", "Slip since reversal", "slip since the last reversal (mm)"),
    ("travel_m", "Travel", "distance moved in all, through all runs (m)"),
)
UNITS = {"position": " (mm)", "speed": " (mm/s)", "slip since reversal": " (mm)", "travel": " (m)", "time": " (s)"}
HINTS = {
    "position_mm": "A droop to both ends is clamping lost off centre, or speed; a slope alike in push and pull is a "
    "taper, opposite slopes are elastic.",
    "speed_mm_s": "A trend here that has no counterpart over position is speed dependence.",
    "slip_mm": "A spike near 0 is the start of the stroke: slack, breakaway, elastic parts.",
    "travel_m": "A slope is wear or bedding in; a step is a sudden change of clamping.",
}


def draw(data: DiagnosisData) -> dict[str, Any]:
    """All pictures of a diagnosis page by place."""
    loops = _loops(data)
    return {
        "curves": _curves(data),
        "first": loops[:FIRST],
        "loops": loops[FIRST:],
        "profiles": [_profile(data, *row) for row in COORDINATES],
        "maps": [_map(data)],
        "energy": _energy(data),
        "shape": _shape(data),
    }


def _curves(data: DiagnosisData) -> list[Picture]:
    """Draw the curves that were found, each over its coordinate: the first pictures of the page."""
    out = []
    for c in data.record.get("coordinates") or ():
        table = c.get("curve")
        if not table:
            continue
        at, mean, low, high = (np.array([number(v) for v in table[key]]) for key in ("at", "mean", "q05", "q95"))
        name = say.over_words(c["coordinate"]).removeprefix("the ")
        unit = "" if c.get("unit") in (None, "", "1") else f" ({c['unit']})"
        again = ", one period" if c.get("period") else ""
        what = "sliding force" if c.get("action") == "capacity" else "added force"
        names = "; ".join(say.title_of(n) for n in c.get("matches") or ())
        out.append(
            Picture(
                draw_.curve(at, mean, low, high, f"{name}{again}{unit}"),
                f"Curve of the {what} over {name}{again}, per cent of Fy, with its 90 % band.",
                f"{say.curve_words(c)} Probability {say.percent(c.get('probability'))}. "
                + (f"Known mechanism: {names}." if names else "No known mechanism has this curve."),
                f"Change of the {what} over {name}",
                wide=True,
            )
        )
    return out


def _loops(data: DiagnosisData) -> list[Picture]:
    c = data.channels
    out = []
    for run in np.unique(c.run)[:MOST]:
        at = shown_cycle(c, int(run))
        after = c.after_kN[at] if c.changed else None
        before_rms, after_rms = (_rms(r[at]) for r in c.residuals)
        error = f"The base law misses these points by {words.short(before_rms)} kN in root mean square"
        error += f", the law with what was found by {words.short(after_rms)} kN." if c.changed else "."
        out.append(
            Picture(
                draw_.loop(c.position_mm[at], c.force_kN[at], c.before_kN[at], after),
                f"Force over displacement for one large cycle of run {run}: measured points, the base law"
                + (" and the law with what was found." if c.changed else "."),
                error,
                f"Run {run}, one cycle of the largest stroke",
            )
        )
    return out


def _profile(data: DiagnosisData, name: str, title: str, axis: str) -> Picture:
    c = data.channels
    values = getattr(c, name)
    bins = travel_bins(c) if name == "travel_m" else N_BINS
    sides = [profile(values, r, c.direction, c.used, bins) for r in c.residuals]
    parts = [("before", sides[0]), ("after", sides[1])] if c.changed else [("", sides[0])]
    largest = [float(np.nanmax(np.abs([p.push_kN, p.pull_kN]), initial=0.0)) for p in sides]
    text = f"The mean misfit reaches {_size(largest[0], data)}"
    text += f" before and {_size(largest[1], data)} after. " if c.changed else ". "
    return Picture(
        draw_.profiles(parts, axis, data.capacity_kN),
        f"Mean of what is left over against {axis.partition(' (')[0]}, push and pull"
        + (", before and after on the same axes." if c.changed else "."),
        text + HINTS[name],
        title,
        wide=c.changed,
    )


def _map(data: DiagnosisData) -> Picture:
    c = data.channels
    parts: list[tuple[str, Map]] = [
        (name, position_travel(c, r)) for name, r in zip(("before", "after"), c.residuals, strict=True)
    ]
    if not c.changed:
        parts = [("", parts[0][1])]
    return Picture(
        draw_.maps(parts),
        "Coloured maps of what is left over against stroke position and travel, push and pull"
        + (", before and after on one colour scale." if c.changed else "."),
        "Red: the device resists more than the law says; blue: less; white: no difference; grey: not visited. Stripes "
        "along the travel axis come from place, stripes across it from wear, heat or the amplitude block.",
        "Position and travel",
        wide=True,
    )


def _energy(data: DiagnosisData) -> Picture | None:
    e = data.record.get("energy") or {}
    columns = [np.array([number(v) for v in e.get(k, ())]) for k in ("cycle", "measured_J", "before_J", "after_J")]
    cycle, measured, before, after = columns
    if not cycle.size or len({column.size for column in columns}) > 1 or not np.isfinite(measured).any():
        return None
    errors = [100 * (np.nansum(v) / np.nansum(measured) - 1) for v in (before, after)]
    text = f"In all, the base law predicts {_more(errors[0])}"
    text += f"; with what was found, {_more(errors[1])}." if data.channels.changed else "."
    return Picture(
        draw_.energy(cycle, measured, before, after if data.channels.changed else None),
        "Energy of each cycle or half-cycle, measured and modelled, and the error of the models in per cent.",
        text,
        wide=True,
    )


def _shape(data: DiagnosisData) -> Picture | None:
    u = data.record.get("unknown") or {}
    columns = say.shape_columns(u.get("shape"))
    if not columns:
        return None
    (first, at), *rest = columns.items()
    coordinate = str(u.get("coordinate") or first)
    coordinate += UNITS.get(coordinate, "")
    # Along the motion, as everywhere on the page: the record keeps the sign of the force.
    along = [(_name(n), -v if _name(n) == "pull" else v) for n, v in rest]
    return Picture(
        draw_.shape(at, along, coordinate),
        f"What no effect explains, against {coordinate}.",
        "Mean of measured less modelled force, counted along the motion: above 0 the device resists more than the law "
        "says. The numbers are in diagnosis.json, there with the sign of the force.",
        wide=True,
    )


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _size(kN: float, data: DiagnosisData) -> str:
    return f"{words.short(kN)} kN ({say.per_cent(kN / data.capacity_kN)} % of Fy)"


def _name(column: str) -> str:
    """Name of a column without the unit that the axis carries."""
    return column.removesuffix("_kN")


def _more(error: float) -> str:
    if abs(error) < 0.05:
        return "the measured energy to better than 0.1 %"
    return f"{abs(error):.1f} % {'more' if error > 0 else 'less'} energy than was measured"
