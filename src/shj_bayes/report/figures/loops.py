"""Loops, what the model leaves over of them, and energy."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.binned import StrokeProfile
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    NARROW,
    PALE,
    RED,
    SERIES,
    WIDE,
    Axes,
    Figure,
    alike,
    label,
    legend,
    sheet,
    svg,
)
from shj_bayes.report.force_unit import KN, ForceUnit
from shj_bayes.report.numbers import Band, CycleEnergy, CycleShape
from shj_bayes.results.device import IntArray

STROKE, FORCE = "displacement (mm)", "force (kN)"
MAX_POINTS, MAX_OVER_SPEED = 6000, 2500
COLUMNS = 1200  # of a diagram over time: more than a screen has pixels for it


def cycle(parts: Sequence[tuple[str, FloatArray, FloatArray, Band]], unit: ForceUnit) -> str:
    """One cycle of each run: measured points, median of the law and the band of what would be measured.

    `parts` holds name, displacement, force and band of each run, arrays of shape (n,).
    """
    figure, axes = sheet(NARROW, 295)
    for (name, x, force, band), colour in zip(parts, SERIES, strict=False):
        # A loop is two curves over the same stroke; one ribbon along the path covers both.
        axes.fill(x, band.force_low, band.force_high, color=colour, alpha=0.22)
        axes.plot(x, force, ".", size=2.4, alpha=0.8)
        axes.plot(x, band.median, color=colour, linewidth=1.3, label=f"{name}: model")
    axes.plot([], [], ".", label="measured")
    axes.fill([], [], [], color=GREY, alpha=0.3, label="90 % of points expected")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 2)
    return svg(figure)


def all_cycles(x: FloatArray, force: FloatArray, band: Band, starts: IntArray, unit: ForceUnit) -> str:
    """All cycles of one run, measured over predicted; `starts` are the first samples of the half-cycles."""
    figure, axes = sheet()
    step = max(1, x.size // MAX_POINTS)
    # Half-cycle by half-cycle: as one shape, ribbons that lie over one another would cancel.
    for a, b in pairwise([*starts.tolist(), x.size]):
        part = slice(a, b, step)
        axes.fill(x[part], band.force_low[part], band.force_high[part], color=BLUE, alpha=0.12)
    axes.plot(x[::step], force[::step], linewidth=0.6, alpha=0.8, label="measured")
    axes.plot(x[::step], band.median[::step], color=RED, linewidth=0.8, label="model (median)")
    axes.fill([], [], [], color=BLUE, alpha=0.3, label="90 % band")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def energy(energies: Sequence[CycleEnergy]) -> str:
    """Energy of every cycle, measured and predicted."""
    figure, axes = sheet()
    largest = max(float(e.measured_J.max()) for e in energies)
    unit, factor = ("kJ", 1e-3) if largest >= 1000 else ("J", 1.0)
    at = 0
    for e, colour in zip(energies, SERIES, strict=False):
        number, gap = at + np.arange(1.0, e.measured_J.size + 1), np.full(e.measured_J.size, np.nan)
        bars = np.stack([e.low_J, e.high_J, gap], axis=1).ravel() * factor
        axes.plot(np.repeat(number, 3), bars, color=colour, linewidth=2)
        axes.plot(number, e.median_J * factor, "_", color=colour, size=13, label=f"run {e.run}: model, 90 %")
        axes.plot(number, e.measured_J * factor, "o", hollow=True)
        at += e.measured_J.size
    axes.plot([], [], "o", hollow=True, label="measured")
    axes.from_zero()
    _cycles(axes, f"energy of the cycle ({unit})")
    legend(axes, 2)
    return svg(figure)


def over_time(
    time_s: FloatArray, force: FloatArray, median: FloatArray, noise: tuple[float, float], unit: ForceUnit
) -> str:
    """Force over time of one run, measured and modelled, and the residual below it with the band of the noise."""
    figure = Figure(WIDE, 330, (3, 2))
    above, below = figure.axes
    left = force - median
    above.plot(*extremes(time_s, force), linewidth=0.8, label="measured")
    above.plot(*extremes(time_s, median), color=RED, linewidth=0.7, label="model (median)")
    below.fill([-np.inf, np.inf], noise[0], noise[1], color=BLUE, alpha=0.15, label="noise of the fit (90 %)")
    below.plot(*extremes(time_s, left), linewidth=0.5, label="residual")
    below.across(0)
    reach = 1.25 * float(np.quantile(np.abs(left), 0.999)) or 1.0
    below.y_range = (-reach, reach)
    alike(figure.axes, x=True)
    label(above, "", FORCE, unit)
    label(below, "time (s)", "residual (kN)", unit)
    above.x_numbers = 0
    legend(above, 2)
    legend(below, 2)
    return svg(figure)


def extremes(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest of every few neighbours, in their order: of a dense line they look like all of it."""
    few = 2 * max(1, x.size // (2 * COLUMNS))
    parts = np.nan_to_num(y[: x.size // few * few].reshape(-1, few), nan=np.inf)
    ends = np.sort(np.stack([parts.argmin(axis=1), np.where(parts < np.inf, parts, -np.inf).argmax(axis=1)]), axis=0)
    at = np.append((ends + few * np.arange(len(parts))).T.ravel(), np.arange(parts.size, x.size))
    return x[at], y[at]


def channels(time_s: FloatArray, extras: Sequence[tuple[str, FloatArray]]) -> str:
    """Further channels over time, one below the other; title with unit, and values, of each."""
    figure = Figure(WIDE, 108 * len(extras) + 43, [1] * len(extras))
    for axes, (title, values) in zip(figure.axes, extras, strict=True):
        axes.plot(*extremes(time_s, values), color=BLUE, linewidth=0.9)
        label(axes, "", title)
        axes.x_numbers = 0
    alike(figure.axes, x=True)
    figure.axes[-1].x_title, figure.axes[-1].x_numbers = "time (s)", None
    return svg(figure)


def over_speed(runs: Sequence[tuple[str, FloatArray, FloatArray, FloatArray]], unit: ForceUnit) -> str:
    """Force over velocity: measured points and the model's; name, velocity, measured and modelled of each run."""
    figure, axes = sheet()
    for (name, speed, force, median), colour in zip(runs, SERIES, strict=False):
        keep = slice(None, None, max(1, speed.size // MAX_OVER_SPEED))
        axes.plot(speed[keep], force[keep], ".", size=2.2, alpha=0.5)
        axes.plot(speed[keep], median[keep], ".", color=colour, size=2.2, alpha=0.6)
        axes.plot([], [], ".", color=colour, size=7, label=f"{name}: model")
    axes.plot([], [], ".", size=7, label="measured")
    label(axes, "velocity (mm/s)", FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def envelope(shapes: Sequence[CycleShape], unit: ForceUnit) -> str:
    """Largest and sliding force of every cycle, push and pull."""
    figure, axes = sheet()
    at = 0
    for shape, colour in zip(shapes, SERIES, strict=False):
        number = at + np.arange(1, shape.push_kN.size + 1)
        for sign, peak, flat in ((1, shape.push_kN, shape.push_sliding_kN), (-1, shape.pull_kN, shape.pull_sliding_kN)):
            marker = "^" if sign > 0 else "v"
            axes.plot(number, sign * peak, marker, color=colour, hollow=True)
            axes.plot(number, sign * flat, f"{marker}-", color=colour, linewidth=1)
        axes.plot([], [], "-", color=colour, label=f"run {shape.run}")
        at += shape.push_kN.size
    axes.plot([], [], "^", label="push")
    axes.plot([], [], "v", label="pull")
    axes.from_zero()
    _cycles(axes, FORCE, unit)
    legend(axes, 4)
    return svg(figure)


def backbone(shapes: Sequence[CycleShape], unit: ForceUnit) -> str:
    """Force where the cycles turn, measured and modelled, in the order of the displacement there."""
    figure, axes = sheet()
    for shape, colour in zip(shapes, SERIES, strict=False):
        order = np.argsort(shape.turn_mm)
        axes.plot(shape.turn_mm[order], shape.model_turn_kN[order], color=colour, linewidth=1.3)
        axes.plot(shape.turn_mm, shape.turn_kN, "o", color=colour, hollow=True)
        axes.plot([], [], "o-", color=colour, label=f"run {shape.run}")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def damping(shapes: Sequence[CycleShape]) -> str:
    """Equivalent viscous damping of every cycle, measured and modelled."""
    figure, axes = sheet()
    at = 0
    for shape, colour in zip(shapes, SERIES, strict=False):
        number = at + np.arange(1, shape.damping_percent.size + 1)
        axes.plot(number, shape.model_damping_percent, "_", color=colour, size=13, label=f"run {shape.run}: model")
        axes.plot(number, shape.damping_percent, "o", hollow=True)
        at += shape.damping_percent.size
    axes.plot([], [], "o", hollow=True, label="measured")
    axes.from_zero(70)
    _cycles(axes, "equivalent damping (%)")
    legend(axes, 3)
    return svg(figure)


def prior(x: FloatArray, prior_kN: FloatArray, paper_kN: FloatArray, posterior_kN: FloatArray, unit: ForceUnit) -> str:
    """Loops that the priors allow, those of the published devices (of which there may be none), and what is left.

    Displacement of one closed cycle has shape (n,), forces (m, n).
    """
    figure, axes = sheet(WIDE, 281)
    groups = (
        (prior_kN, PALE, 0.6, "allowed before the test"),
        (paper_kN, GREEN, 0.9, "devices of the published tables"),
        (posterior_kN, BLUE, 1.6, "this device, after the test"),
    )
    for forces, colour, width, words in groups:
        if forces.size:
            lines = np.pad(forces, ((0, 0), (0, 1)), constant_values=np.nan)
            along = np.tile(np.append(x, np.nan), len(forces))
            axes.plot(along, lines.ravel(), color=colour, linewidth=width, alpha=0.8, label=words)
    axes.x_range = (1.05 * x.min(), 1.05 * x.max())
    reach = 1.15 * float(np.quantile(np.abs(prior_kN).max(axis=1), 0.97))
    reach = max(reach, 1.1 * float(np.abs(posterior_kN).max()))
    axes.y_range = (-reach, reach)
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def over_stroke(profiles: Sequence[StrokeProfile], unit: ForceUnit) -> str:
    """Mean residual over stroke, push and pull of one run, with what noise alone would give."""
    figure, axes = sheet(NARROW, 230)
    for profile, colour, style, name in zip(
        profiles, (BLUE, RED), ("o-", "s-"), ("displacement growing", "displacement falling"), strict=False
    ):
        axes.fill(profile.centre_mm, profile.low_kN, profile.high_kN, color=colour, alpha=0.16)
        axes.plot(profile.centre_mm, profile.mean_kN, style, color=colour, size=4, linewidth=1.2, label=name)
    axes.fill([], [], [], color=GREY, alpha=0.3, label="noise alone (90 %)")
    axes.across(0)
    label(axes, STROKE, "mean residual (kN)", unit)
    legend(axes, 2)
    return svg(figure)


def _cycles(axes: Axes, y: str, unit: ForceUnit = KN) -> None:
    """Titles of a diagram over the cycles."""
    axes.whole = True
    label(axes, "cycle, in the order they were made", y, unit)
