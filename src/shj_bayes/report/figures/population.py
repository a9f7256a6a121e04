"""Sets of devices side by side, and the curves of their devices."""

import math
from collections.abc import Sequence

import numpy as np

from shj_bayes.margins.curves import CurveContrast
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.population.predict import LoopBand
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    LETTER,
    NARROW,
    ORANGE,
    SERIES,
    WIDE,
    Figure,
    alike,
    drawn,
    label,
    legend,
    sheet,
    short_name,
    svg,
)
from shj_bayes.report.sets import SetBand
from shj_bayes.results.diagnosis import CurveRecord

MAX_NAME = 34
MAX_COLUMNS = 3  # panels side by side
CROWD = 24  # devices of a set beyond which their dots would hide the band; they get a lane of their own below it


def bands(rows: Sequence[SetBand], title: str) -> str:
    """Draw tested devices, and the band of a new one, in one quantity of every set, below one another."""
    crowded = max((len(row.devices) for row in rows), default=0) > CROWD
    names = [f"{short_name(row.name, MAX_NAME)} ({row.n_devices})" for row in rows]
    room = 9 * LETTER * max(map(len, names), default=0) + 14
    figure, axes = sheet(WIDE, 65 + (40 if crowded else 26) * len(rows), left=room)
    left, right = span(rows)
    for place, row in enumerate(rows):
        y = place - 0.24 * crowded
        low, middle, high = row.band
        axes.plot(row.widest, (y, y), color=GREY, linewidth=1.4)
        axes.plot((low, high), (y, y), color=BLUE, linewidth=8, alpha=0.45)
        axes.plot((middle, middle), (y - 0.22, y + 0.22), color=BLUE, linewidth=2)
        for edge, beyond, marker in ((left, row.widest[0] < left, "<"), (right, row.widest[1] > right, ">")):
            if beyond:
                axes.plot(edge, y, marker, color=GREY, size=6)
        if crowded:
            lane = place + 0.4 * (np.arange(len(row.devices)) * 0.618 % 1.0)  # even, and the same every time
            middles = [d_middle for _, (_, d_middle, _) in row.devices]
            axes.plot(middles, lane, "o", color=INK, size=3, alpha=0.4)
            continue
        for k, (_, (d_low, d_middle, d_high)) in enumerate(row.devices):
            at = y + (0.09 if k % 2 else -0.09) * (len(row.devices) > 1)
            axes.plot((d_low, d_high), (at, at), color=INK, linewidth=1)
            axes.plot(d_middle, at, "o", color=INK, size=4)
    axes.x_range = (left, right)
    axes.plot([], [], "o" if crowded else "o-", color=INK, size=4, linewidth=1, label="tested device")
    axes.plot([], [], color=BLUE, linewidth=8, alpha=0.45, label="new device, 90 %")
    axes.plot([], [], color=GREY, linewidth=1.4, label="under other assumptions on the spread")
    axes.rows, axes.y_range = names, (len(rows) - 0.5, -0.5)
    return drawn(figure, title, "", 3)


def apart(curve: CurveContrast) -> str:
    """Draw how far the force of two sets differs along a coordinate, per cent, with the 90 % band at each value."""
    figure, axes = sheet(NARROW, 202)
    places = sorted([(curve.reference, (0.0, 0.0, 0.0)), *zip(curve.at, curve.percent, strict=True)])
    at = [u for u, _ in places]
    low, middle, high = zip(*(band for _, band in places), strict=True)
    axes.fill(at, low, high, color=BLUE, alpha=0.25)
    axes.plot(at, middle, "o-", color=BLUE, size=4, linewidth=1.4)
    axes.across(0)
    unit = "" if curve.unit == "1" else f" ({curve.unit})"
    return drawn(
        figure, f"{coordinate_named(curve.coordinate).title.removeprefix('the ')}{unit}", "difference (% of the force)"
    )


def span(rows: Sequence[SetBand]) -> tuple[float, float]:
    """Range of the sheet: all tested devices and the bands of tested sets, not what is nearly unknown."""
    tested = [row for row in rows if row.devices] or list(rows)
    ends = [end for row in tested for end in (row.band[0], row.band[2])]
    ends += [end for row in tested for _, interval in row.devices for end in interval]
    low, high = min(ends), max(ends)
    margin = 0.5 * (high - low) or 1.0
    return (max(0.0, low - margin) if low >= 0 else low - margin), high + margin


def loop(parts: Sequence[LoopBand]) -> str:
    """Band of the loop of a new device of one set, one colour for each run, and each law of what was not tested."""
    figure, axes = sheet(NARROW, 245)
    for band, colour in zip(parts, SERIES, strict=False):
        which = "median and 90 %" if band.law == "tested" else band.law
        for force in (band.push, band.pull):
            axes.fill(band.displacement_mm, force[0], force[2], color=colour, alpha=0.25)
            axes.plot(band.displacement_mm, force[1], color=colour, linewidth=1.4)
        axes.plot([], [], color=colour, label=f"run {band.run}, {which}")
    return drawn(figure, "displacement (mm)", "force (kN)", 2)


def curves(parts: Sequence[tuple[str, Sequence[tuple[CurveRecord, bool]]]], axis: str) -> str:
    """Draw the curves of the devices of each set with 90 % bands, per cent of Fy; the same scale in all panels.

    Beside each stands whether the device shows it alone; otherwise its set makes it certain.
    """
    columns = min(MAX_COLUMNS, len(parts))
    rows = math.ceil(len(parts) / columns)
    figure = Figure(WIDE, 223 * rows, [1] * rows, columns, gap=(14, 24), top=22)
    figure.axes = figure.axes[: len(parts)]
    words = {True: (BLUE, "-", "shown alone"), False: (ORANGE, "--", "certain by the set")}
    for place, (axes, (name, bands)) in enumerate(zip(figure.axes, parts, strict=True)):
        axes.across(0)
        seen: set[bool] = set()
        for curve, alone in bands:
            colour, style, said = words[alone]
            axes.fill(curve.at, curve.q05, curve.q95, color=colour, alpha=0.12)
            axes.plot(curve.at, curve.mean, style, color=colour, label="" if alone in seen else said)
            seen.add(alone)
        axes.title = name[:40]
        label(axes, axis if place >= len(parts) - columns else "", "" if place % columns else "change (% of Fy)")
        legend(axes, 1)
    alike(figure.axes, x=True, y=True)
    for place, axes in enumerate(figure.axes):
        axes.rows = ("",) if place % columns else ()
        axes.x_numbers = None if place >= len(parts) - columns else 0
    return svg(figure)
