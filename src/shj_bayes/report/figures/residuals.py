"""What the model leaves over."""

from __future__ import annotations

from collections.abc import Sequence

from shj_bayes.report.binned import StrokeProfile
from shj_bayes.report.figures.canvas import BLUE, GREY, INK, NARROW, RED, label, legend, sheet, svg
from shj_bayes.report.force_unit import KN, ForceUnit


def over_stroke(profiles: Sequence[StrokeProfile], unit: ForceUnit = KN) -> str:
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
