"""Pictures of a plan: displacement over time, and what the test would show if one or the other were true."""

from collections.abc import Sequence

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, PALE, RED, WIDE, Figure, alike, label, legend, sheet, svg

MOST = 6000  # points of a line


def history(time_s: FloatArray, x_mm: FloatArray, speed_mm_s: FloatArray) -> str:
    """Displacement over time, with the speed below it."""
    figure = Figure(WIDE, 302, (3, 1))
    top, low = figure.axes
    keep = _thin(time_s.size)
    top.plot(time_s[keep], x_mm[keep], color=BLUE, linewidth=1.0)
    low.plot(time_s[keep], speed_mm_s[keep], linewidth=0.8)
    alike(figure.axes, x=True)
    top.x_numbers = 0
    label(top, "", "displacement (mm)")
    label(low, "time (s)", "speed (mm/s)")
    return svg(figure)


def rivals(x_mm: FloatArray, first_kN: FloatArray, second_kN: FloatArray, names: tuple[str, str]) -> str:
    """Predicted loops if one rival is true and if the other is, on the same axes."""
    figure = Figure(WIDE, 288, columns=2, top=22)
    keep = _thin(x_mm.size)
    for axes, force, other, colour, name in zip(
        figure.axes, (first_kN, second_kN), (second_kN, first_kN), (BLUE, RED), names, strict=True
    ):
        axes.plot(x_mm[keep], other[keep], color=PALE, linewidth=0.8)
        axes.plot(x_mm[keep], force[keep], color=colour, linewidth=0.9)
        axes.title = f"if {name}"
        label(axes, "displacement (mm)", "force (kN)" if axes is figure.axes[0] else "")
    alike(figure.axes, y=True)
    figure.axes[1].rows = ("",)
    return svg(figure)


def apart(time_s: FloatArray, difference_kN: FloatArray, noise_kN: float) -> str:
    """Force of one rival less that of the other, over time, with the noise of one sample."""
    figure, axes = sheet(WIDE, 202)
    keep = _thin(time_s.size)
    ends, band = [-np.inf, np.inf], 2 * noise_kN
    axes.fill(ends, -band, band, color=PALE, alpha=0.5, label="noise of a sample, 95 %")
    axes.plot(time_s[keep], difference_kN[keep], color=BLUE, linewidth=0.9, label="first less second")
    label(axes, "time (s)", "difference (kN)")
    legend(axes, 2)
    return svg(figure)


def devices(n: Sequence[float], expected: Sequence[float], assured: Sequence[float], within: float) -> str:
    """Half width of the 5 % force over the number of further devices."""
    figure, axes = sheet(WIDE, 216)
    axes.across(100 * within, "--", label="wanted")
    axes.plot(n, 100 * np.asarray(expected), "o-", color=BLUE, size=4, label="typical")
    axes.plot(n, 100 * np.asarray(assured), "s-", color=RED, size=4, label="kept with a chance of 80 %")
    label(axes, "further devices", "half width (% of the force)")
    legend(axes, 3)
    return svg(figure)


def _thin(n: int) -> slice:
    return slice(None, None, max(1, n // MOST))
