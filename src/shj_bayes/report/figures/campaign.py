"""Curves of the devices of some sets, a panel for each set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, INK, ORANGE, WIDE, label, legend, svg, tidy

COLUMNS = 3


@dataclass(frozen=True, eq=False)
class DeviceCurve:
    """Curve of a device with its 90 % band.

    Parameters
    ----------
    at : array, shape (n,)
        Coordinate in its unit.
    mean, low, high : array, shape (n,)
        Change, per cent of Fy.
    alone : bool
        The device shows it alone; otherwise its set makes it certain.
    """

    at: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    alone: bool


def curves(parts: Sequence[tuple[str, Sequence[DeviceCurve]]], axis: str) -> str:
    """Draw the curves of devices with their 90 % bands, per cent of Fy; the same scale in all panels.

    Parameters
    ----------
    parts : sequence of (str, sequence of DeviceCurve)
        Name of each set, and the curves of its devices.
    axis : str
        The coordinate with its unit.

    Returns
    -------
    str
        Data address.
    """
    columns = min(COLUMNS, len(parts))
    rows = math.ceil(len(parts) / columns)
    figure = Figure(figsize=(WIDE, 3.1 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in panels[len(parts) :]:
        axes.set_visible(False)
    words = {True: (BLUE, "-", "shown alone"), False: (ORANGE, "--", "certain by the set")}
    for axes, (name, bands) in zip(panels, parts, strict=False):
        tidy(axes)
        axes.axhline(0, color=INK, linewidth=0.8)
        seen: set[bool] = set()
        for band in bands:
            colour, style, said = words[band.alone]
            axes.fill_between(band.at, band.low, band.high, color=colour, alpha=0.12, linewidth=0)
            once = "" if band.alone in seen else said
            axes.plot(band.at, band.mean, style, color=colour, linewidth=1.4, label=once or None)
            seen.add(band.alone)
        axes.set_title(f"{name[:40]}", fontsize=10, loc="right", color=INK, parse_math=False)
        label(axes, axis, "change (% of Fy)" if axes in panels[::columns] else "")
        legend(axes, 1)
    return svg(figure)
