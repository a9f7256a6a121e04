"""Loops, what the model leaves over of them, and energy."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.ticker import MaxNLocator

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.binned import StrokeProfile
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    NARROW,
    PALE,
    RED,
    SERIES,
    WIDE,
    fixed,
    label,
    legend,
    sheet,
    svg,
    tidy,
)
from shj_bayes.report.force_unit import KN, ForceUnit
from shj_bayes.report.numbers import Band, CycleEnergy, CycleShape
from shj_bayes.results.device import IntArray

STROKE, FORCE = "displacement (mm)", "force (kN)"
MAX_POINTS, MAX_OVER_TIME, MAX_OVER_SPEED = 20_000, 6000, 4000


def cycle(parts: Sequence[tuple[str, FloatArray, FloatArray, Band]], unit: ForceUnit) -> str:
    """One cycle of each run: measured points, median of the law and the band of what would be measured.

    `parts` holds name, displacement, force and band of each run, arrays of shape (n,).
    """
    figure, axes = sheet(NARROW, 4.1, measured=False)
    for (name, x, force, band), colour in zip(parts, SERIES, strict=False):
        # A loop is two curves over the same stroke; one ribbon along the path covers both.
        axes.fill_between(x, band.force_low, band.force_high, color=colour, alpha=0.22, linewidth=0, rasterized=True)
        axes.plot(x, force, ".", color=INK, markersize=2.4, alpha=0.8, markeredgewidth=0, rasterized=True)
        axes.plot(x, band.median, color=colour, linewidth=1.3, label=f"{name}: model")
    axes.plot([], [], ".", color=INK, markersize=6, label="measured")
    axes.fill_between([], [], [], color=GREY, alpha=0.3, label="90 % of points expected")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 2)
    return svg(figure)


def all_cycles(x: FloatArray, force: FloatArray, band: Band, starts: IntArray, unit: ForceUnit) -> str:
    """All cycles of one run, measured over predicted; `starts` are the first samples of the half-cycles."""
    figure, axes = sheet(measured=False)
    step = max(1, x.size // MAX_POINTS)
    # Half-cycle by half-cycle: as one shape, ribbons that lie over one another would cancel.
    parts = [slice(a, b, step) for a, b in pairwise([*starts.tolist(), x.size])]
    there, back = ([np.column_stack([x[p], edge[p]]) for p in parts] for edge in (band.force_low, band.force_high))
    ribbons = [np.concatenate([low, high[::-1]]) for low, high in zip(there, back, strict=True)]
    axes.add_collection(PolyCollection(ribbons, color=BLUE, alpha=0.12, linewidth=0, rasterized=True))
    keep = slice(None, None, step)
    axes.plot(x[keep], force[keep], color=INK, linewidth=0.6, alpha=0.8, label="measured", rasterized=True)
    axes.plot(x[keep], band.median[keep], color=RED, linewidth=0.8, label="model (median)", rasterized=True)
    axes.fill_between([], [], [], color=BLUE, alpha=0.3, label="90 % band")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def energy(energies: Sequence[CycleEnergy]) -> str:
    """Energy of every cycle, measured and predicted."""
    figure, axes = sheet(measured=False)
    largest = max(float(e.measured_J.max()) for e in energies)
    unit, factor = ("kJ", 1e-3) if largest >= 1000 else ("J", 1.0)
    at = 0
    for e, colour in zip(energies, SERIES, strict=False):
        number = at + np.arange(1, e.measured_J.size + 1)
        middle = e.median_J * factor
        error = np.stack([(e.median_J - e.low_J), (e.high_J - e.median_J)]) * factor
        axes.errorbar(
            number, middle, np.maximum(error, 0.0), fmt="_", color=colour, markersize=13, capsize=5, elinewidth=2,
            label=f"run {e.run}: model, 90 %",
        )  # fmt: skip
        axes.plot(
            number, e.measured_J * factor, "o", color=INK, markersize=4.5, markerfacecolor="none", markeredgewidth=1.2
        )
        at += e.measured_J.size
    axes.plot([], [], "o", color=INK, markersize=4.5, markerfacecolor="none", label="measured")
    axes.set_ylim(bottom=0)
    _cycles(axes, f"energy of the cycle ({unit})")
    legend(axes, 2)
    return svg(figure)


def over_time(
    time_s: FloatArray, force: FloatArray, median: FloatArray, noise: tuple[float, float], unit: ForceUnit
) -> str:
    """Force over time of one run, measured and modelled, and the residual below it with the band of the noise."""
    figure = fixed(WIDE, 4.6)
    split = {"height_ratios": (3, 2), "hspace": 0.22}
    above, below = (tidy(axes) for axes in figure.subplots(2, 1, sharex=True, gridspec_kw=split))
    keep = slice(None, None, max(1, time_s.size // MAX_OVER_TIME))
    above.plot(time_s[keep], force[keep], color=INK, linewidth=0.8, label="measured", rasterized=True)
    above.plot(time_s[keep], median[keep], color=RED, linewidth=0.7, label="model (median)", rasterized=True)
    left = force - median
    below.axhspan(*noise, color=BLUE, alpha=0.15, linewidth=0, label="noise of the fit (90 %)")
    below.plot(time_s[keep], left[keep], color=INK, linewidth=0.5, rasterized=True, label="residual")
    below.axhline(0, color=INK, linewidth=0.8)
    reach = 1.25 * float(np.quantile(np.abs(left), 0.999)) or 1.0
    below.set_ylim(-reach, reach)
    label(above, "", FORCE, unit)
    label(below, "time (s)", "residual (kN)", unit)
    legend(above, 2)
    legend(below, 2)
    return svg(figure)


def channels(time_s: FloatArray, extras: Sequence[tuple[str, FloatArray]]) -> str:
    """Further channels over time, one below the other; title with unit, and values, of each."""
    figure = fixed(WIDE, 1.5 * len(extras) + 0.6)
    panels = figure.subplots(len(extras), 1, sharex=True, squeeze=False)[:, 0]
    keep = slice(None, None, max(1, time_s.size // MAX_OVER_TIME))
    for axes, (title, values) in zip(panels, extras, strict=True):
        tidy(axes)
        axes.plot(time_s[keep], values[keep], color=BLUE, linewidth=0.9, rasterized=True)
        label(axes, "", title.replace("$", r"\$"))
    label(panels[-1], "time (s)", extras[-1][0].replace("$", r"\$"))
    return svg(figure)


def over_speed(runs: Sequence[tuple[str, FloatArray, FloatArray, FloatArray]], unit: ForceUnit) -> str:
    """Force over velocity: measured points and the model's; name, velocity, measured and modelled of each run."""
    figure, axes = sheet(measured=False)
    for (name, speed, force, median), colour in zip(runs, SERIES, strict=False):
        keep = slice(None, None, max(1, speed.size // MAX_OVER_SPEED))
        for values, ink, alpha in ((force, INK, 0.5), (median, colour, 0.6)):
            dots = axes.plot(speed[keep], values[keep], ".", color=ink, markersize=2.2, alpha=alpha, rasterized=True)
            dots[0].set_markeredgewidth(0)
        axes.plot([], [], ".", color=colour, markersize=7, label=f"{name}: model")
    axes.plot([], [], ".", color=INK, markersize=7, label="measured")
    label(axes, "velocity (mm/s)", FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def envelope(shapes: Sequence[CycleShape], unit: ForceUnit) -> str:
    """Largest and sliding force of every cycle, push and pull."""
    figure, axes = sheet(measured=False)
    at = 0
    for shape, colour in zip(shapes, SERIES, strict=False):
        number = at + np.arange(1, shape.push_kN.size + 1)
        for sign, peak, flat in ((1, shape.push_kN, shape.push_sliding_kN), (-1, shape.pull_kN, shape.pull_sliding_kN)):
            marker = "^" if sign > 0 else "v"
            axes.plot(number, sign * peak, marker, color=colour, markersize=4.5, markerfacecolor="none")
            axes.plot(number, sign * flat, marker + "-", color=colour, markersize=4.5, linewidth=1)
        axes.plot([], [], "-", color=colour, label=f"run {shape.run}")
        at += shape.push_kN.size
    axes.plot([], [], "^", color=INK, markersize=4.5, label="push")
    axes.plot([], [], "v", color=INK, markersize=4.5, label="pull")
    axes.set_ylim(bottom=0)
    _cycles(axes, FORCE, unit)
    legend(axes, 4)
    return svg(figure)


def backbone(shapes: Sequence[CycleShape], unit: ForceUnit) -> str:
    """Force where the cycles turn, measured and modelled, in the order of the displacement there."""
    figure, axes = sheet(measured=False)
    for shape, colour in zip(shapes, SERIES, strict=False):
        order = np.argsort(shape.turn_mm)
        axes.plot(shape.turn_mm[order], shape.model_turn_kN[order], "-", color=colour, linewidth=1.3)
        axes.plot(shape.turn_mm, shape.turn_kN, "o", color=colour, markersize=4.5, markerfacecolor="none")
        axes.plot([], [], "o-", color=colour, markersize=4.5, label=f"run {shape.run}")
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def damping(shapes: Sequence[CycleShape]) -> str:
    """Equivalent viscous damping of every cycle, measured and modelled."""
    figure, axes = sheet(measured=False)
    at = 0
    for shape, colour in zip(shapes, SERIES, strict=False):
        number = at + np.arange(1, shape.damping_percent.size + 1)
        axes.plot(number, shape.model_damping_percent, "_", color=colour, markersize=13, markeredgewidth=2)
        axes.plot(number, shape.damping_percent, "o", color=INK, markersize=4.5, markerfacecolor="none")
        axes.plot([], [], "_", color=colour, markersize=10, markeredgewidth=2, label=f"run {shape.run}: model")
        at += shape.damping_percent.size
    axes.plot([], [], "o", color=INK, markersize=4.5, markerfacecolor="none", label="measured")
    axes.set_ylim(0, 70)
    _cycles(axes, "equivalent damping (%)")
    legend(axes, 3)
    return svg(figure)


def prior(x: FloatArray, prior_kN: FloatArray, paper_kN: FloatArray, posterior_kN: FloatArray, unit: ForceUnit) -> str:
    """Loops that the priors allow, those of the published devices (of which there may be none), and what is left.

    Displacement of one closed cycle has shape (n,), forces (m, n).
    """
    figure, axes = sheet(WIDE, 3.9, measured=False)
    for forces, colour, width in ((prior_kN, PALE, 0.6), (paper_kN, GREEN, 0.9), (posterior_kN, BLUE, 1.6)):
        lines = [np.column_stack([x, force]) for force in forces]
        axes.add_collection(LineCollection(lines, color=colour, linewidth=width, alpha=0.8, rasterized=True))
    axes.set_xlim(1.05 * x.min(), 1.05 * x.max())
    axes.plot([], [], color=PALE, label="allowed before the test")
    if paper_kN.size:
        axes.plot([], [], color=GREEN, label="devices of the published tables")
    axes.plot([], [], color=BLUE, linewidth=2, label="this device, after the test")
    reach = 1.15 * float(np.quantile(np.abs(prior_kN).max(axis=1), 0.97))
    reach = max(reach, 1.1 * float(np.abs(posterior_kN).max()))
    axes.set_ylim(-reach, reach)
    label(axes, STROKE, FORCE, unit)
    legend(axes, 3)
    return svg(figure)


def over_stroke(profiles: Sequence[StrokeProfile], unit: ForceUnit) -> str:
    """Mean residual over stroke, push and pull of one run, with what noise alone would give."""
    figure, axes = sheet(NARROW, 3.2, measured=False)
    for profile, colour, marker, name in zip(
        profiles, (BLUE, RED), ("o", "s"), ("displacement growing", "displacement falling"), strict=False
    ):
        axes.fill_between(profile.centre_mm, profile.low_kN, profile.high_kN, color=colour, alpha=0.16, linewidth=0)
        axes.plot(
            profile.centre_mm, profile.mean_kN, marker + "-", color=colour, markersize=4, linewidth=1.2, label=name
        )
    axes.fill_between([], [], [], color=GREY, alpha=0.3, label="noise alone (90 %)")
    axes.axhline(0, color=INK, linewidth=0.8)
    label(axes, "displacement (mm)", "mean residual (kN)", unit)
    legend(axes, 2)
    return svg(figure)


def _cycles(axes: Axes, y: str, unit: ForceUnit = KN) -> None:
    """Titles of a diagram over the cycles."""
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    label(axes, "cycle, in the order they were made", y, unit)
