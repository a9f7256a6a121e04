"""Before and after: loops, residual maps, parity, energy, errors."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.diagnosis_numbers import Map, Profile
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    NARROW,
    ORANGE,
    RED,
    WIDE,
    fixed,
    label,
    legend,
    plain,
    sheet,
    svg,
    tidy,
)  # fmt: skip
from shj_bayes.report.force_unit import ForceUnit
from shj_bayes.results.device import BoolArray

BASE, MORE = RED, BLUE  # the base law, the law with what was found
# White in the middle; red and blue stay apart with every common form of colour blindness. Grey: not visited.
MAP = mpl.colormaps["RdBu_r"].with_extremes(bad="#D9D9D9")


def loop(x: FloatArray, measured: FloatArray, before: FloatArray, after: FloatArray | None, unit: ForceUnit) -> str:
    """One cycle: measured points, base law, and the law with what was found (None where nothing was)."""
    figure, axes = sheet(NARROW, 3.9, measured=False)
    axes.plot(x, measured, ".", color=INK, markersize=2.6, alpha=0.75, markeredgewidth=0, rasterized=True)
    axes.plot([], [], ".", color=INK, markersize=6, label="measured")
    axes.plot(x, before, color=BASE, linewidth=1.4, linestyle="--" if after is not None else "-", label="base law")
    if after is not None:
        axes.plot(x, after, color=MORE, linewidth=1.5, label="with what was found")
    label(axes, "distance from mid-stroke (mm)", "force (kN)", unit)
    legend(axes, 3)
    return svg(figure)


def profiles(parts: Sequence[tuple[str, Profile]], axis: str, capacity_kN: float, unit: ForceUnit) -> str:
    """Mean direction-signed residual over one coordinate, panels side by side on the same axes."""
    figure = fixed(WIDE if len(parts) > 1 else NARROW, 2.9, right=0.75)
    panels = _panels(figure, len(parts))
    reach = 1.12 * max(_reach(p.push_kN, p.pull_kN) for _, p in parts)
    for axes, (title, p) in zip(panels, parts, strict=True):
        axes.axhline(0, color=INK, linewidth=0.8)
        for mean, colour, marker, name in ((p.push_kN, BLUE, "o", "push"), (p.pull_kN, RED, "s", "pull")):
            seen = np.isfinite(mean)
            axes.plot(p.centre[seen], mean[seen], marker + "-", color=colour, markersize=3.8, linewidth=1.2, label=name)
        axes.set_ylim(-reach, reach)
        axes.set_title(title, fontsize=10, loc="right", color=INK)
        label(axes, axis, "left over (kN)" if axes is panels[0] else "", unit)
        legend(axes, 2)
    share = panels[-1].twinx()
    share.set_ylim(-100 * reach / capacity_kN, 100 * reach / capacity_kN)
    share.spines[["top", "left"]].set_visible(False)
    share.set_ylabel("% of Fy", fontsize=10.5, color=INK)
    share.tick_params(labelsize=9.5, colors=INK)
    return svg(figure)


def maps(parts: Sequence[tuple[str, Map]], unit: ForceUnit) -> str:
    """Mean direction-signed residual over position and travel; push and pull of each part, one colour scale."""
    figure = Figure(figsize=(WIDE, 3.6), layout="constrained")
    panels = _panels(figure, 2 * len(parts))
    sides = np.concatenate([side for _, m in parts for side in (m.push_kN, m.pull_kN)], axis=None)
    reach = unit.factor * float(np.nanquantile(np.abs(sides), 0.99)) or 1.0
    scale, image = Normalize(-reach, reach), None
    for k, (title, m) in enumerate(parts):
        for j, (values, name) in enumerate(((m.push_kN, "push"), (m.pull_kN, "pull"))):
            axes = panels[2 * k + j]
            axes.grid(visible=False)
            shown = np.ma.masked_invalid(unit.factor * values)
            image = axes.pcolormesh(m.position_mm, m.travel_m, shown, cmap=MAP, norm=scale, rasterized=True)
            axes.set_title(f"{title}, {name}" if title else name, fontsize=10, color=INK)
            axes.set_xlabel("position (mm)", fontsize=10, color=INK)
    panels[0].set_ylabel("travel (m)", fontsize=10.5, color=INK)
    if image is not None:
        bar = figure.colorbar(image, ax=panels, aspect=28, pad=0.01, extend="both")
        bar.set_label(f"left over ({unit.name})", fontsize=10, color=INK)
        bar.ax.tick_params(labelsize=9)
    return svg(figure)


def energy(number: FloatArray, measured_J: FloatArray, before_J: FloatArray, after_J: FloatArray | None) -> str:
    """Energy of each cycle, and below it the error of the models."""
    figure = fixed(WIDE, 4.6, left=0.95)
    top, low = (tidy(axes) for axes in figure.subplots(2, 1, sharex=True, height_ratios=(3, 2)))
    unit, factor = ("kJ", 1e-3) if np.nanmax(np.abs(measured_J)) >= 1000 else ("J", 1.0)
    top.plot(number, factor * measured_J, "o", color=INK, markersize=5.5, markerfacecolor="none", label="measured")
    models = [(before_J, BASE, "x", "base law")]
    models += [(after_J, MORE, "+", "with what was found")] if after_J is not None else []
    with np.errstate(divide="ignore", invalid="ignore"):
        for values, colour, marker, name in models:
            top.plot(number, factor * values, marker, color=colour, markersize=6, label=name)
            low.plot(number, 100 * (values / measured_J - 1), marker + "-", color=colour, markersize=5, linewidth=0.9)
    top.set_ylim(bottom=0)
    low.axhline(0, color=INK, linewidth=0.8)
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
    figure, axes = sheet(WIDE, 3.4, measured=False)
    axes.axhline(0, color=INK, linewidth=0.8)
    there = np.ones(at.size, dtype=np.bool_) if known is None else known
    axes.fill_between(at, low, high, where=there, color=BLUE, alpha=0.22, linewidth=0, label="90 % band")
    axes.plot(at, np.where(there, mean, np.nan), color=BLUE, linewidth=1.8, label="curve found")
    if not there.all():
        axes.plot(at, mean, color=BLUE, linewidth=1.0, linestyle=":", label="in between, not measured")
    label(axes, plain(axis), "change (% of Fy)")
    legend(axes, 3)
    return svg(figure)


def shape(x: FloatArray, columns: Sequence[tuple[str, FloatArray]], axis: str, unit: ForceUnit) -> str:
    """Shape of what no effect explains."""
    figure, axes = sheet(WIDE, 2.9, measured=False)
    axes.axhline(0, color=INK, linewidth=0.8)
    for (name, values), colour, marker in zip(columns, (BLUE, RED, ORANGE, GREY), "os^D", strict=False):
        axes.plot(x, values, marker + "-", color=colour, markersize=4, linewidth=1.2, label=plain(name))
    label(axes, plain(axis), "left over (kN)", unit)
    legend(axes, 4)
    return svg(figure)


def _panels(figure: Figure, n: int) -> list[Axes]:
    return [tidy(axes) for axes in figure.subplots(1, n, sharey=True, squeeze=False, gridspec_kw={"wspace": 0.14})[0]]


def _reach(*values: FloatArray) -> float:
    whole = np.abs(np.concatenate(values))
    return float(np.nanmax(whole)) if np.isfinite(whole).any() else 1.0
