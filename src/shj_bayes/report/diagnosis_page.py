"""The page of a diagnosis: its pictures, and how it is drawn."""

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import UndefinedError

from shj_bayes.errors import ReportError
from shj_bayes.model.parameters import FloatArray
from shj_bayes.report import diagnosis_words as say
from shj_bayes.report.browse import diagnosis_viewer, thinning_words
from shj_bayes.report.diagnosis_numbers import (
    N_BINS,
    DiagnosisData,
    position_travel,
    profile,
    read_diagnosis,
    shown_cycle,
    travel_bins,
)
from shj_bayes.report.figures import diagnosis as draw_
from shj_bayes.report.page import LOOPS, PAGE, write_page
from shj_bayes.results.device import BoolArray, Channels

FIRST = 2  # loops on the first screen
MOST = 6  # runs that are drawn
COORDINATES = (
    ("position_mm", "Stroke position", "distance from mid-stroke (mm)"),
    ("speed_mm_s", "Speed", "speed (mm/s)"),
    ("slip_mm", "Slip since reversal", "slip since the last reversal (mm)"),
    ("travel_m", "Travel", "distance moved in all, through all runs (m)"),
)
SENSES = {"push": 1, "pull": -1}
UNITS = {"position": " (mm)", "speed": " (mm/s)", "slip since reversal": " (mm)", "travel": " (m)", "time": " (s)"}


def draw(data: DiagnosisData) -> dict[str, Any]:
    """All pictures of a diagnosis page by place, with what the page says of them."""
    loops = _loops(data)
    return {
        "curves": _curves(data),
        "first": loops[:FIRST],
        "loops": loops[FIRST:],
        "profiles": {name: _profile(data, name, title, axis) for name, title, axis in COORDINATES},
        "maps": _map(data),
        "energy": _energy(data),
        "shape": _shape(data),
    }


def _curves(data: DiagnosisData) -> list[dict[str, Any]]:
    """Draw the curves that were found, each over its coordinate: the first pictures of the page."""
    out = []
    for c in data.record.coordinates:
        if c.curve is None:
            continue
        at, mean, low, high = map(np.array, (c.curve.at, c.curve.mean, c.curve.q05, c.curve.q95))
        name = say.along_words(c.coordinate).removeprefix("the ")
        unit = "" if c.unit in ("", "1") else f" ({c.unit})"
        over = f"{name}{', one period' if c.period else ''}"
        what = ("sliding force" if c.action == "capacity" else "added force") + say.way_words(c)
        sense = SENSES.get(c.direction) if c.coordinate == "time" else None
        known = moves(data.channels, at, sense) if sense else None
        address = draw_.curve(at, mean, low, high, over + unit, known)
        out.append({"address": address, "of": c, "what": what, "name": name, "over": over})
    return out


def moves(channels: Channels, at_s: FloatArray, sense: int) -> BoolArray:
    """Whether a device moves in a direction, +1 or -1, near evenly spaced times of all runs, shape (n,)."""
    runs, place = np.unique(channels.run, return_inverse=True)
    lasts_s = [channels.time_s[channels.run == run].max() for run in runs]
    begun_s = np.append(0.0, np.cumsum(lasts_s))[place]
    half = 0.5 * np.ptp(at_s) / max(at_s.size - 1, 1)
    own = np.sort((begun_s + channels.time_s)[channels.direction == sense])
    return np.asarray(np.searchsorted(own, at_s + half) > np.searchsorted(own, at_s - half))


def _loops(data: DiagnosisData) -> list[dict[str, Any]]:
    c = data.channels
    out = []
    for run in np.unique(c.run)[:MOST]:
        at = shown_cycle(c, int(run))
        after = c.after_kN[at] if c.changed else None
        errors = [float(np.sqrt(np.mean(np.square(r[at])))) for r in c.residuals]
        address = draw_.loop(c.position_mm[at], c.force_kN[at], c.before_kN[at], after, data.force)
        out.append({"address": address, "run": run, "errors": errors})
    return out


def _profile(data: DiagnosisData, name: str, title: str, axis: str) -> dict[str, Any]:
    c = data.channels
    values = getattr(c, name)
    bins = travel_bins(c) if name == "travel_m" else N_BINS
    sides = [profile(values, r, c.direction, c.used, bins) for r in c.residuals]
    parts = [("before", sides[0]), ("after", sides[1])] if c.changed else [("", sides[0])]
    largest = [float(np.nanmax(np.abs([p.push_kN, p.pull_kN]), initial=0.0)) for p in sides]
    address = draw_.profiles(parts, axis, data.capacity_kN, data.force)
    return {"address": address, "title": title, "axis": axis.partition(" (")[0], "largest": largest}


def _map(data: DiagnosisData) -> str:
    c = data.channels
    before, after = (position_travel(c, r) for r in c.residuals)
    return draw_.maps([("before", before), ("after", after)] if c.changed else [("", before)], data.force)


def _energy(data: DiagnosisData) -> dict[str, Any] | None:
    e = data.record.energy
    columns = [np.array(values) for values in (e.cycle, e.measured_J, e.before_J, e.after_J)]
    cycle, measured, before, after = columns
    if not cycle.size or len({column.size for column in columns}) > 1:
        return None
    errors = [float(100 * (v.sum() / measured.sum() - 1)) for v in (before, after)]
    address = draw_.energy(cycle, measured, before, after if data.channels.changed else None)
    return {"address": address, "errors": errors}


def _shape(data: DiagnosisData) -> dict[str, str] | None:
    u = data.record.unknown
    columns = say.shape_columns(u.shape) if u else {}
    if u is None or not columns:
        return None
    (first, at), *rest = columns.items()
    coordinate = u.coordinate or first
    coordinate += UNITS.get(coordinate, "")
    # Along the motion, as everywhere on the page: the record keeps the sign of the force. The axis carries the unit.
    named = [(name.removesuffix("_kN"), values) for name, values in rest]
    along = [(name, -values if name == "pull" else values) for name, values in named]
    return {"address": draw_.shape(at, along, coordinate, data.force), "coordinate": coordinate}


def render_diagnosis(folder: Path) -> Path:
    """Write ``diagnosis.html`` of a finished diagnosis, one file that needs nothing else; `ReportError` without one."""
    data = read_diagnosis(folder)
    try:
        viewer = diagnosis_viewer(data)
        content = {
            "name": data.record.device,
            "data": data,
            "force": data.force,
            "record": data.record,
            "say": say,
            "changed": data.channels.changed,
            "pictures": draw(data),
            "viewer": viewer,
            "thinning": thinning_words(viewer),
            "fit": PAGE if (folder / PAGE).exists() else "",  # page of the fit that lies in the same folder
        }
        return write_page(folder, "diagnosis.html", content, LOOPS)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, UndefinedError) as error:
        raise ReportError(
            f"diagnosis.json in {folder.name} cannot be shown, {type(error).__name__}: {error}; run diagnose again"
        ) from error
