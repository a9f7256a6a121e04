"""Before and after: loops, residual maps, parity, energy, errors."""

from collections.abc import Sequence

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.diagnosis_numbers import Map, Profile
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
from shj_bayes.report.force_unit import ForceUnit
from shj_bayes.results.device import BoolArray

BASE, MORE = RED, BLUE  # the base law, the law with what was found


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


def profiles(parts: Sequence[tuple[str, Profile]], axis: str, capacity_kN: float, unit: ForceUnit) -> str:
    """Mean direction-signed residual over one coordinate, panels side by side on the same axes."""
    figure = Figure(WIDE if len(parts) > 1 else NARROW, 209, columns=len(parts), right=54)
    reach = 1.12 * max(_reach(p.push_kN, p.pull_kN) for _, p in parts)
    for axes, (title, p) in zip(figure.axes, parts, strict=True):
        axes.across(0)
        for mean, colour, style, name in ((p.push_kN, BLUE, "o-", "push"), (p.pull_kN, RED, "s-", "pull")):
            seen = np.isfinite(mean)
            axes.plot(p.centre[seen], mean[seen], style, color=colour, size=3.8, linewidth=1.2, label=name)
        axes.y_range, axes.title = (-reach, reach), title
        label(axes, axis, "left over (kN)", unit)
        legend(axes, 2)
    _side_by_side(figure.axes)
    figure.axes[-1].right = (100 / capacity_kN, "% of Fy")
    return svg(figure)


def maps(parts: Sequence[tuple[str, Map]], unit: ForceUnit) -> str:
    """Mean direction-signed residual over position and travel; push and pull of each part, one colour scale."""
    figure = Figure(WIDE, 259, columns=2 * len(parts), top=22, right=90)
    sides = [
        (title, m, side, values) for title, m in parts for side, values in (("push", m.push_kN), ("pull", m.pull_kN))
    ]
    reach = float(np.nanquantile(np.abs(np.concatenate([values for *_, values in sides], axis=None)), 0.99)) or 1.0
    for axes, (title, m, side, values) in zip(figure.axes, sides, strict=True):
        axes.mesh(m.position_mm, m.travel_m, values, reach)
        axes.x_range, axes.y_range = (m.position_mm[0], m.position_mm[-1]), (m.travel_m[0], m.travel_m[-1])
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
