"""What the model leaves over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.binned import StrokeProfile
from shj_bayes.report.data import IntArray
from shj_bayes.report.figures.canvas import BLUE, GREY, INK, NARROW, RED, WIDE, label, legend, sheet, svg

LEFT_OVER = "measured minus model (kN)"
MAX_POINTS = 4000


def over_stroke(profiles: Sequence[StrokeProfile]) -> str:
    """Mean residual over stroke, push and pull of one run, with what noise alone would give."""
    figure, axes = sheet(NARROW, 3.2)
    for profile, colour, marker, name in zip(
        profiles, (BLUE, RED), ("o", "s"), ("displacement growing", "displacement falling"), strict=False
    ):
        axes.fill_between(profile.centre_mm, profile.low_kN, profile.high_kN, color=colour, alpha=0.16, linewidth=0)
        axes.plot(
            profile.centre_mm, profile.mean_kN, marker + "-", color=colour, markersize=4, linewidth=1.2, label=name
        )
    axes.fill_between([], [], [], color=GREY, alpha=0.3, label="noise alone (90 %)")
    axes.axhline(0, color=INK, linewidth=0.8)
    label(axes, "displacement (mm)", f"mean of {LEFT_OVER}")
    legend(axes, 2)
    return svg(figure)


def over_time(time_s: FloatArray, residual_kN: FloatArray, noise_kN: tuple[float, float]) -> str:
    """Residual over time of one run, with the band that holds 90 % of the fitted noise."""
    figure, axes = sheet(WIDE, 2.8)
    keep = slice(None, None, max(1, time_s.size // MAX_POINTS))
    axes.axhspan(*noise_kN, color=BLUE, alpha=0.15, linewidth=0, label="noise of the fit (90 %)")
    axes.plot(time_s[keep], residual_kN[keep], color=INK, linewidth=0.5, alpha=0.8, rasterized=True, label="left over")
    axes.axhline(0, color=INK, linewidth=0.8)
    reach = 1.25 * float(np.quantile(np.abs(residual_kN), 0.999))
    axes.set_ylim(-reach, reach)
    label(axes, "time (s)", LEFT_OVER)
    legend(axes, 2)
    return svg(figure)


def over_displacement(x: FloatArray, residual_kN: FloatArray, direction: IntArray) -> str:
    """Residual over displacement of one run, coloured by direction."""
    figure, axes = sheet(NARROW, 3.2)
    keep = slice(None, None, max(1, x.size // MAX_POINTS))
    for sign, colour, name in ((1, BLUE, "displacement growing"), (-1, RED, "displacement falling")):
        mine = direction[keep] == sign
        axes.plot(
            x[keep][mine], residual_kN[keep][mine], ".", color=colour, markersize=2, alpha=0.35, markeredgewidth=0,
            rasterized=True,
        )  # fmt: skip
        axes.plot([], [], ".", color=colour, markersize=7, label=name)
    axes.axhline(0, color=INK, linewidth=0.8)
    reach = 1.25 * float(np.quantile(np.abs(residual_kN), 0.999))
    axes.set_ylim(-reach, reach)
    label(axes, "displacement (mm)", LEFT_OVER)
    legend(axes, 2)
    return svg(figure)
