"""The page of a diagnosis and its pictures: loops before and after, curves, maps of what is left over, energy."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import UndefinedError

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.errors import ReportError
from shj_bayes.report import diagnosis_words as say
from shj_bayes.report.browse import diagnosis_viewer, thinning_words
from shj_bayes.report.diagnosis_words import unit_of
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREY,
    NARROW,
    ORANGE,
    RED,
    WIDE,
    Axes,
    Figure,
    label,
    legend,
    sheet,
    short_name,
    svg,
)
from shj_bayes.report.numbers import bin_means, edges_of, index_in
from shj_bayes.report.page import LOOPS, PAGE, write_page
from shj_bayes.report.words import ForceUnit
from shj_bayes.results.device import DiagnosisData, read_diagnosis

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
N_BINS, N_POSITION, MAX_TRAVEL = 24, 24, 40
FEWEST = 3  # samples of a bin that is drawn
BASE, MORE = RED, BLUE  # the base law, the law with what was found


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
        known = moves(data, at, sense) if sense else None
        address = curve(at, mean, low, high, over + unit, known)
        out.append({"address": address, "of": c, "what": what, "name": name, "over": over})
    return out


def moves(data: DiagnosisData, at_s: FloatArray, sense: int) -> BoolArray:
    """Whether a device moves in a direction, +1 or -1, near evenly spaced times of all runs, shape (n,)."""
    runs, place = np.unique(data.run, return_inverse=True)
    lasts_s = [data.time_s[data.run == run].max() for run in runs]
    begun_s = np.append(0.0, np.cumsum(lasts_s))[place]
    half = 0.5 * np.ptp(at_s) / max(at_s.size - 1, 1)
    own = np.sort((begun_s + data.time_s)[data.direction == sense])
    return np.asarray(np.searchsorted(own, at_s + half) > np.searchsorted(own, at_s - half))


def _loops(data: DiagnosisData) -> list[dict[str, Any]]:
    out = []
    for run in np.unique(data.run)[:MOST]:
        at = shown_cycle(data, int(run))
        after = data.after_kN[at] if data.changed else None
        errors = [float(np.sqrt(np.mean(np.square(r[at])))) for r in data.residuals]
        address = loop(data.position_mm[at], data.force_kN[at], data.before_kN[at], after, unit_of(data))
        out.append({"address": address, "run": run, "errors": errors})
    return out


@dataclass(frozen=True, eq=False)
class SignedMeans:
    """Mean residual along the motion over one coordinate, or over several; nan where there are too few samples."""

    edges: tuple[FloatArray, ...] = field(repr=False)  # of the bins of each coordinate, shape (n + 1,)
    # push_kN, pull_kN: shape (n,), or (n, m, ...); positive where the device resists more than the law says
    push_kN: FloatArray = field(repr=False)
    pull_kN: FloatArray = field(repr=False)


def signed_means(
    data: DiagnosisData, residual_kN: FloatArray, bins: Mapping[str, int], fewest: int = FEWEST
) -> SignedMeans:
    """Average a residual along the motion in even bins, so many of each coordinate."""
    used, direction, shape = data.used, data.direction, tuple(bins.values())
    values = [getattr(data, name) for name in bins]
    edges = [edges_of(value[used], n) for value, n in zip(values, shape, strict=True)]
    cell = np.ravel_multi_index([index_in(v, e) for v, e in zip(values, edges, strict=True)], shape)
    push, pull = (
        bin_means(cell, residual_kN * direction, used & (direction == sign), math.prod(shape), fewest).reshape(shape)
        for sign in (1, -1)
    )
    return SignedMeans(tuple(edges), push, pull)


def travel_bins(data: DiagnosisData) -> int:
    """About one bin for each large cycle, so that push and pull are both in it."""
    used = data.used
    cycle_m = 2 * float(np.ptp(data.position_mm[used])) / 1000
    return int(np.clip(round(float(np.ptp(data.travel_m[used])) / max(cycle_m, 1e-9)), 4, MAX_TRAVEL))


def shown_cycle(data: DiagnosisData, run: int) -> slice:
    """Choose the samples of one cycle of a run to show: its last two neighbouring half-cycles of the largest stroke."""
    mine = np.flatnonzero(data.run == run)
    turns = mine[1:][np.diff(data.direction[mine]) != 0]
    ends = [int(mine[0]), *turns.tolist(), int(mine[-1]) + 1]
    halves = list(pairwise(ends))
    strokes = [float(np.ptp(data.position_mm[a:b])) for a, b in halves]
    large = [s >= 0.95 * max(strokes) for s in strokes]
    pairs = [i for i in range(len(halves) - 1) if large[i] and large[i + 1]]
    if not pairs:
        return slice(ends[0], ends[-1])
    return slice(halves[pairs[-1]][0], halves[pairs[-1] + 1][1])


def _profile(data: DiagnosisData, name: str, title: str, axis: str) -> dict[str, Any]:
    bins = {name: travel_bins(data) if name == "travel_m" else N_BINS}
    sides = [signed_means(data, r, bins) for r in data.residuals]
    parts = [("before", sides[0]), ("after", sides[1])] if data.changed else [("", sides[0])]
    largest = [float(np.nanmax(np.abs([p.push_kN, p.pull_kN]), initial=0.0)) for p in sides]
    address = profiles(parts, axis, data.capacity_kN, unit_of(data))
    return {"address": address, "title": title, "axis": axis.partition(" (")[0], "largest": largest}


def _map(data: DiagnosisData) -> str:
    bins = {"travel_m": travel_bins(data), "position_mm": N_POSITION}
    before, after = (signed_means(data, r, bins, fewest=1) for r in data.residuals)
    return maps([("before", before), ("after", after)] if data.changed else [("", before)], unit_of(data))


def _energy(data: DiagnosisData) -> dict[str, Any] | None:
    e = data.record.energy
    columns = [np.array(values) for values in (e.cycle, e.measured_J, e.before_J, e.after_J)]
    cycle, measured, before, after = columns
    if not cycle.size or len({column.size for column in columns}) > 1:
        return None
    errors = [float(100 * (v.sum() / measured.sum() - 1)) for v in (before, after)]
    address = energy(cycle, measured, before, after if data.changed else None)
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
    return {"address": shape(at, along, coordinate, unit_of(data)), "coordinate": coordinate}


def render_diagnosis(folder: Path) -> Path:
    """Write ``diagnosis.html`` of a finished diagnosis, one file that needs nothing else; `ReportError` without one."""
    data = read_diagnosis(folder)
    try:
        viewer = diagnosis_viewer(data)
        content = {
            "name": data.record.device,
            "data": data,
            "force": unit_of(data),
            "record": data.record,
            "say": say,
            "changed": data.changed,
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


def loop(x: FloatArray, measured: FloatArray, before: FloatArray, after: FloatArray | None, unit: ForceUnit) -> str:
    """One cycle: measured points, base law, and the law with what was found (None where nothing was)."""
    figure, axes = sheet(NARROW, 281)
    axes.plot(x, measured, ".", size=2.6, alpha=0.75)
    axes.plot([], [], ".", size=6, label="measured")
    axes.plot(x, before, "-" if after is None else "--", color=BASE, label="base law")
    if after is not None:
        axes.plot(x, after, color=MORE, label="with what was found")
    label(axes, "distance from mid-stroke (mm)", "force (kN)", unit)
    legend(axes, 3)
    return svg(figure)


def profiles(parts: Sequence[tuple[str, SignedMeans]], axis: str, capacity_kN: float, unit: ForceUnit) -> str:
    """Mean direction-signed residual over one coordinate, panels side by side on the same axes."""
    figure = Figure(WIDE if len(parts) > 1 else NARROW, 209, columns=len(parts), right=54)
    reach = 1.12 * max(_reach(p.push_kN, p.pull_kN) for _, p in parts)
    for axes, (title, p) in zip(figure.axes, parts, strict=True):
        centre = 0.5 * (p.edges[0][:-1] + p.edges[0][1:])
        axes.across(0)
        for mean, colour, style, name in ((p.push_kN, BLUE, "o-", "push"), (p.pull_kN, RED, "s-", "pull")):
            seen = np.isfinite(mean)
            axes.plot(centre[seen], mean[seen], style, color=colour, size=3.8, linewidth=1.2, label=name)
        axes.y_range, axes.title = (-reach, reach), title
        label(axes, axis, "left over (kN)", unit)
        legend(axes, 2)
    _side_by_side(figure.axes)
    figure.axes[-1].right = (100 / capacity_kN, "% of Fy")
    return svg(figure)


def maps(parts: Sequence[tuple[str, SignedMeans]], unit: ForceUnit) -> str:
    """Mean direction-signed residual over position and travel; push and pull of each part, one colour scale."""
    figure = Figure(WIDE, 259, columns=2 * len(parts), top=22, right=90)
    sides = [
        (title, m, side, values) for title, m in parts for side, values in (("push", m.push_kN), ("pull", m.pull_kN))
    ]
    reach = float(np.nanquantile(np.abs(np.concatenate([values for *_, values in sides], axis=None)), 0.99)) or 1.0
    for axes, (title, m, side, values) in zip(figure.axes, sides, strict=True):
        travel, position = m.edges
        axes.mesh(position, travel, values, reach)
        axes.x_range, axes.y_range = (position[0], position[-1]), (travel[0], travel[-1])
        axes.title, axes.grid = f"{title}, {side}" if title else side, False
        label(axes, "position (mm)", "travel (m)")
    _side_by_side(figure.axes)
    last = figure.axes[-1]
    bar = Axes(last.left + last.width + 14, last.top, 12, last.height)
    steps = np.linspace(-reach, reach, 65)
    bar.mesh(np.array([0.0, 1.0]), steps, 0.5 * (steps[1:] + steps[:-1])[:, None], reach)
    bar.x_range, bar.y_range, bar.x_numbers, bar.grid = (0.0, 1.0), (-reach, reach), 0, False
    bar.rows, bar.right = ("",), (unit.factor, f"left over ({unit.name})")
    figure.axes.append(bar)
    return svg(figure)


def energy(number: FloatArray, measured_J: FloatArray, before_J: FloatArray, after_J: FloatArray | None) -> str:
    """Energy of each cycle, and below it the error of the models."""
    figure = Figure(WIDE, 331, (3, 2), left=68)
    top, low = figure.axes
    unit, factor = ("kJ", 1e-3) if np.nanmax(np.abs(measured_J)) >= 1000 else ("J", 1.0)
    top.plot(number, factor * measured_J, "o", size=5.5, hollow=True, label="measured")
    models = [(before_J, BASE, "x", "base law")]
    models += [(after_J, MORE, "+", "with what was found")] if after_J is not None else []
    with np.errstate(divide="ignore", invalid="ignore"):
        for values, colour, marker, name in models:
            top.plot(number, factor * values, marker, color=colour, size=6, label=name)
            low.plot(number, 100 * (values / measured_J - 1), f"{marker}-", color=colour, size=5, linewidth=0.9)
    top.from_zero()
    top.x_numbers = 0
    low.across(0)
    label(top, "", f"energy ({unit})")
    label(
        low,
        "cycle, in the order they were made (half-cycles where there are few)",
        "model minus\nmeasured (%)",
    )
    legend(top, 3)
    return svg(figure)


def curve(
    at: FloatArray, mean: FloatArray, low: FloatArray, high: FloatArray, axis: str, known: BoolArray | None = None
) -> str:
    """Draw a curve that was found over its coordinate, with its 90 % band, per cent of Fy.

    Dotted and without the band where it is not `known`, shape (n,); known everywhere by default.
    """
    figure, axes = sheet(WIDE, 245)
    axes.across(0)
    there = np.ones(at.size, dtype=np.bool_) if known is None else known
    for piece in np.split(np.arange(at.size), np.flatnonzero(np.diff(there)) + 1):
        if there[piece].all():
            axes.fill(at[piece], low[piece], high[piece], color=BLUE, alpha=0.22)
    axes.fill([], [], [], color=BLUE, alpha=0.22, label="90 % band")
    axes.plot(at, np.where(there, mean, np.nan), color=BLUE, linewidth=1.8, label="curve found")
    if not there.all():
        axes.plot(at, mean, ":", color=BLUE, linewidth=1.0, label="in between, not measured")
    label(axes, short_name(axis), "change (% of Fy)")
    legend(axes, 3)
    return svg(figure)


def shape(x: FloatArray, columns: Sequence[tuple[str, FloatArray]], axis: str, unit: ForceUnit) -> str:
    """Shape of what no effect explains."""
    figure, axes = sheet(WIDE, 209)
    axes.across(0)
    for (name, values), colour, marker in zip(columns, (BLUE, RED, ORANGE, GREY), "os^D", strict=False):
        axes.plot(x, values, f"{marker}-", color=colour, size=4, linewidth=1.2, label=short_name(name))
    label(axes, short_name(axis), "left over (kN)", unit)
    legend(axes, 4)
    return svg(figure)


def _side_by_side(panels: Sequence[Axes]) -> None:
    """Numbers and title along y at the first of panels on the same scale alone."""
    for axes in panels[1:]:
        axes.y_title, axes.rows = "", ("",)


def _reach(*values: FloatArray) -> float:
    whole = np.abs(np.concatenate(values))
    return float(np.nanmax(whole)) if np.isfinite(whole).any() else 1.0
