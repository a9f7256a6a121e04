"""Pictures of a plan: displacement over time, and what the test would show if one or the other were true."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, INK, PALE, RED, WIDE, label, legend, sheet, svg, tidy

MOST = 6000  # points of a line


def history(time_s: FloatArray, x_mm: FloatArray, speed_mm_s: FloatArray) -> str:
    """Displacement over time, with the speed below it."""
    figure = Figure(figsize=(WIDE, 4.2), layout="constrained")
    top, low = (tidy(axes) for axes in figure.subplots(2, 1, sharex=True, height_ratios=(3, 1)))
    keep = _thin(time_s.size)
    top.plot(time_s[keep], x_mm[keep], color=BLUE, linewidth=1.0)
    low.plot(time_s[keep], speed_mm_s[keep], color=INK, linewidth=0.8)
    label(top, "", "displacement (mm)")
    label(low, "time (s)", "speed (mm/s)")
    return svg(figure)


def rivals(x_mm: FloatArray, first_kN: FloatArray, second_kN: FloatArray, names: tuple[str, str]) -> str:
    """Predicted loops if one rival is true and if the other is, on the same axes."""
    figure = Figure(figsize=(WIDE, 4.0), layout="constrained")
    panels = [tidy(axes) for axes in figure.subplots(1, 2, sharey=True)]
    keep = _thin(x_mm.size)
    for axes, force, other, colour, name in zip(
        panels, (first_kN, second_kN), (second_kN, first_kN), (BLUE, RED), names, strict=True
    ):
        axes.plot(x_mm[keep], other[keep], color=PALE, linewidth=0.8)
        axes.plot(x_mm[keep], force[keep], color=colour, linewidth=0.9)
        axes.set_title(f"if {name}", fontsize=10, color=INK, loc="left")
        label(axes, "displacement (mm)", "force (kN)" if axes is panels[0] else "")
    return svg(figure)


def apart(time_s: FloatArray, difference_kN: FloatArray, noise_kN: float) -> str:
    """Force of one rival less that of the other, over time, with the noise of one sample."""
    figure, axes = sheet(WIDE, 2.8)
    keep = _thin(time_s.size)
    axes.axhspan(-2 * noise_kN, 2 * noise_kN, color=PALE, alpha=0.5, linewidth=0, label="noise of a sample, 95 %")
    axes.plot(time_s[keep], difference_kN[keep], color=BLUE, linewidth=0.9, label="first less second")
    label(axes, "time (s)", "difference (kN)")
    legend(axes, 2)
    return svg(figure)


def devices(n: Sequence[float], expected: Sequence[float], assured: Sequence[float], within: float) -> str:
    """Half width of the 5 % force over the number of further devices."""
    figure, axes = sheet(WIDE, 3.0)
    axes.axhline(100 * within, color=INK, linewidth=0.9, linestyle="--", label="wanted")
    axes.plot(n, 100 * np.asarray(expected), "o-", color=BLUE, markersize=4, label="typical")
    axes.plot(n, 100 * np.asarray(assured), "s-", color=RED, markersize=4, label="kept with a chance of 80 %")
    label(axes, "further devices", "half width (% of the force)")
    legend(axes, 3)
    return svg(figure)


def _thin(n: int) -> slice:
    return slice(None, None, max(1, n // MOST))
