"""The page of a diagnosis and its pictures: loops before and after, curves, maps of what is left over, energy."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

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
    drawn,
    label,
    legend,
    sheet,
    short_name,
    svg,
)
from shj_bayes.report.numbers import bin_means, edges_of, index_in
from shj_bayes.report.page import LOOPS, PAGE, write_page
from shj_bayes.results.device import DiagnosisData, read_diagnosis
from shj_bayes.results.diagnosis import DependenceRecord

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


Means = tuple[str, "SignedMeans"]  # with the title of their panel


def draw(data: DiagnosisData) -> dict[str, Any]:
    """All pictures of a diagnosis page by place, with what the page says of them."""
    loops = [loop(data, int(run)) for run in np.unique(data.run)[:MOST]]
    return {
        "curves": [curve(data, c) for c in data.record.coordinates if c.curve],
        "first": loops[:FIRST],
        "loops": loops[FIRST:],
        "profiles": {name: profile(data, name, title, axis) for name, title, axis in COORDINATES},
        "maps": maps(data),
        "energy": energy(data),
        "shape": shape(data),
    }


def curve(data: DiagnosisData, c: DependenceRecord) -> dict[str, Any]:
    """Draw a curve that was found over its coordinate, with its 90 % band, per cent of Fy.

    Over time it is dotted and without the band where the device does not move in its direction.
    """
    assert c.curve is not None
    at, mean, low, high = map(np.array, (c.curve.at, c.curve.mean, c.curve.q05, c.curve.q95))
    name = say.along_words(c.coordinate).removeprefix("the ")
    over = f"{name}{', one period' if c.period else ''}"
    sense = SENSES.get(c.direction) if c.coordinate == "time" else None
    there = moves(data, at, sense) if sense else np.ones(at.size, dtype=np.bool_)
    figure, axes = sheet(WIDE, 245)
    axes.across(0)
    for piece in np.split(np.arange(at.size), np.flatnonzero(np.diff(there)) + 1):
        if there[piece].all():
            axes.fill(at[piece], low[piece], high[piece], color=BLUE, alpha=0.22)
    axes.fill([], [], [], color=BLUE, alpha=0.22, label="90 % band")
    axes.plot(at, np.where(there, mean, np.nan), color=BLUE, linewidth=1.8, label="curve found")
    if not there.all():
        axes.plot(at, mean, ":", color=BLUE, linewidth=1.0, label="in between, not measured")
    title = short_name(over + ("" if c.unit in ("", "1") else f" ({c.unit})"))
    what = ("sliding force" if c.action == "capacity" else "added force") + say.way_words(c)
    address = drawn(figure, title, "change (% of Fy)", 3)
    return {"address": address, "of": c, "what": what, "name": name, "over": over}


def moves(data: DiagnosisData, at_s: FloatArray, sense: int) -> BoolArray:
    """Whether a device moves in a direction, +1 or -1, near evenly spaced times of all runs, shape (n,)."""
    runs, place = np.unique(data.run, return_inverse=True)
    lasts_s = [data.time_s[data.run == run].max() for run in runs]
    begun_s = np.append(0.0, np.cumsum(lasts_s))[place]
    half = 0.5 * np.ptp(at_s) / max(at_s.size - 1, 1)
    own = np.sort((begun_s + data.time_s)[data.direction == sense])
    return np.asarray(np.searchsorted(own, at_s + half) > np.searchsorted(own, at_s - half))


def loop(data: DiagnosisData, run: int) -> dict[str, Any]:
    """One cycle: measured points, base law, and the law with what was found, where something was."""
    at, figure = shown_cycle(data, run), Figure(NARROW, 281)
    axes, x = figure.axes[0], data.position_mm[at]
    axes.plot(x, data.force_kN[at], ".", size=2.6, alpha=0.75)
    axes.plot([], [], ".", size=6, label="measured")
    axes.plot(x, data.before_kN[at], "--" if data.changed else "-", color=BASE, label="base law")
    if data.changed:
        axes.plot(x, data.after_kN[at], color=MORE, label="with what was found")
    address = drawn(figure, "distance from mid-stroke (mm)", "force (kN)", 3, unit_of(data))
    return {"address": address, "run": run, "errors": [float(np.sqrt(np.mean(r[at] ** 2))) for r in data.residuals]}


class SignedMeans(NamedTuple):
    """Mean residual along the motion over one coordinate, or over several; nan where there are too few samples."""

    edges: tuple[FloatArray, ...]  # of the bins of each coordinate, shape (n + 1,)
    # shape (n,), or (n, m, ...); positive where the device resists more than the law says
    push_kN: FloatArray
    pull_kN: FloatArray


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


def before_and_after(data: DiagnosisData, bins: Mapping[str, int], fewest: int = FEWEST) -> list[Means]:
    """Average what is left over before and, where something was found, after."""
    means = [signed_means(data, r, bins, fewest) for r in data.residuals]
    return list(zip(("before", "after"), means, strict=True)) if data.changed else [("", means[0])]


def profile(data: DiagnosisData, name: str, title: str, axis: str) -> dict[str, Any]:
    """Mean direction-signed residual over one coordinate, panels side by side on the same axes."""
    parts = before_and_after(data, {name: travel_bins(data) if name == "travel_m" else N_BINS})
    largest = [float(np.nanmax(np.abs([p.push_kN, p.pull_kN]), initial=0.0)) for _, p in parts]
    figure = Figure(WIDE if len(parts) > 1 else NARROW, 209, columns=len(parts), right=54)
    seen_anywhere = any(np.isfinite(p.push_kN).any() or np.isfinite(p.pull_kN).any() for _, p in parts)
    reach = 1.12 * (max(largest) if seen_anywhere else 1.0)
    for axes, (panel, p) in zip(figure.axes, parts, strict=True):
        centre = 0.5 * (p.edges[0][:-1] + p.edges[0][1:])
        axes.across(0)
        for mean, colour, style, side in ((p.push_kN, BLUE, "o-", "push"), (p.pull_kN, RED, "s-", "pull")):
            seen = np.isfinite(mean)
            axes.plot(centre[seen], mean[seen], style, color=colour, size=3.8, linewidth=1.2, label=side)
        axes.y_range, axes.title = (-reach, reach), panel
        label(axes, axis, "left over (kN)", unit_of(data))
        legend(axes, 2)
    _side_by_side(figure.axes)
    figure.axes[-1].right = (100 / data.capacity_kN, "% of Fy")
    return {"address": svg(figure), "title": title, "axis": axis.partition(" (")[0], "largest": largest}


def maps(data: DiagnosisData) -> str:
    """Mean direction-signed residual over position and travel; push and pull of each part, one colour scale."""
    parts = before_and_after(data, {"travel_m": travel_bins(data), "position_mm": N_POSITION}, fewest=1)
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
    last, unit = figure.axes[-1], unit_of(data)
    bar = Axes(last.left + last.width + 14, last.top, 12, last.height)
    steps = np.linspace(-reach, reach, 65)
    bar.mesh(np.array([0.0, 1.0]), steps, 0.5 * (steps[1:] + steps[:-1])[:, None], reach)
    bar.x_range, bar.y_range, bar.x_numbers, bar.grid = (0.0, 1.0), (-reach, reach), 0, False
    bar.rows, bar.right = ("",), (unit.factor, f"left over ({unit.name})")
    figure.axes.append(bar)
    return svg(figure)


def energy(data: DiagnosisData) -> dict[str, Any] | None:
    """Energy of each cycle, and below it the error of the models; None where it was not stored."""
    e = data.record.energy
    columns = [np.array(values) for values in (e.cycle, e.measured_J, e.before_J, e.after_J)]
    number, measured, before, after = columns
    if not number.size or len({column.size for column in columns}) > 1:
        return None
    figure = Figure(WIDE, 331, (3, 2), left=68)
    top, low = figure.axes
    unit, factor = ("kJ", 1e-3) if np.nanmax(np.abs(measured)) >= 1000 else ("J", 1.0)
    top.plot(number, factor * measured, "o", size=5.5, hollow=True, label="measured")
    models = [(before, BASE, "x", "base law"), (after, MORE, "+", "with what was found")]
    with np.errstate(divide="ignore", invalid="ignore"):
        for values, colour, marker, name in models[: 1 + data.changed]:
            top.plot(number, factor * values, marker, color=colour, size=6, label=name)
            low.plot(number, 100 * (values / measured - 1), f"{marker}-", color=colour, size=5, linewidth=0.9)
    top.from_zero()
    top.x_numbers = 0
    low.across(0)
    label(top, "", f"energy ({unit})")
    label(low, "cycle, in the order they were made (half-cycles where there are few)", "model minus\nmeasured (%)")
    legend(top, 3)
    errors = [float(100 * (v.sum() / measured.sum() - 1)) for v in (before, after)]
    return {"address": svg(figure), "errors": errors}


def shape(data: DiagnosisData) -> dict[str, str] | None:
    """Shape of what no effect explains; None where there is none that can be drawn."""
    u = data.record.unknown
    columns = say.shape_columns(u.shape) if u else {}
    if u is None or not columns:
        return None
    (first, at), *rest = columns.items()
    coordinate = u.coordinate or first
    coordinate += UNITS.get(coordinate, "")
    figure, axes = sheet(WIDE, 209)
    axes.across(0)
    for (column, values), colour, marker in zip(rest, (BLUE, RED, ORANGE, GREY), "os^D", strict=False):
        # Along the motion, as everywhere on the page: the record keeps the sign of the force. The axis has the unit.
        name = column.removesuffix("_kN")
        along = -values if name == "pull" else values
        axes.plot(at, along, f"{marker}-", color=colour, size=4, linewidth=1.2, label=short_name(name))
    address = drawn(figure, short_name(coordinate), "left over (kN)", 4, unit_of(data))
    return {"address": address, "coordinate": coordinate}


def _side_by_side(panels: Sequence[Axes]) -> None:
    """Numbers and title along y at the first of panels on the same scale alone."""
    for axes in panels[1:]:
        axes.y_title, axes.rows = "", ("",)


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
