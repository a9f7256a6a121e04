"""The pictures of a device page: loops, what the model leaves over of them, energy, densities and traces.

`draw` puts all of them together; the page says what they show.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.noise import noise_parameters
from shj_bayes.model.parameters import base_of
from shj_bayes.model.priors import Prior
from shj_bayes.recording.columns import TENSION
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    NARROW,
    PALE,
    RED,
    SERIES,
    WIDE,
    Figure,
    alike,
    drawn,
    label,
    legend,
    sheet,
    svg,
)
from shj_bayes.report.numbers import Band, Beforehand, Cycles, DeviceFigures, StrokeProfile, pick_cycle
from shj_bayes.report.words import KN, ForceUnit, force_unit
from shj_bayes.results.device import DeviceData, RunData

STROKE, FORCE = "displacement (mm)", "force (kN)"
MAX_POINTS, MAX_OVER_SPEED = 6000, 2500
COLUMNS = 1200  # of a diagram over time: more than a screen has pixels for it
# of a corner plot; bins that its smoothing goes to each side; shares of the draws that are held by its lines
BINS, REACH, SHARES = 24, 3, (0.5, 0.9)
MAX_DOTS, MAX_STEPS = 300, 250  # of each panel of a corner plot; of the trace of an ensemble
Runs = Sequence[tuple[RunData, Band]]


def draw(device: DeviceData, numbers: DeviceFigures) -> dict[str, Any]:
    """All pictures of a device page by place."""
    unit = force_unit(device.record)
    runs = list(zip(device.runs, numbers.bands, strict=True))
    cycles = [one for one in numbers.cycles if one.measured_J.size]
    shown = {row.name: unit.of(row.unit) for row in device.record.parameters}
    units = {name: own for name, (own, _) in shown.items()}
    draws = {name: values * shown[name][1] for name, values in device.draws.items()}
    noise = set(noise_parameters())
    return {
        "hero": cycle(runs, unit),
        "time": [over_time(run, band, unit) for run, band in runs],
        "loops": [
            (
                all_cycles(run, band, unit),
                100 * float(np.mean((run.force_kN >= band.force_low) & (run.force_kN <= band.force_high))),
            )
            for run, band in runs
        ],
        "speed": over_speed(runs, unit),
        "residuals": [over_stroke(profiles, unit) for profiles in numbers.profiles],
        "cycles": cycles
        and {
            "envelope": envelope(cycles, unit),
            "backbone": backbone(cycles, unit),
            "energy": energy(cycles),
            "damping": damping(cycles),
        },
        "channels": [
            one
            for run, entry in zip(device.runs, device.record.inputs, strict=True)
            if (one := channels(run, entry.extras))
        ],
        "densities": densities(device, unit, draws, units),
        "corner": corner({name: v.ravel() for name, v in draws.items() if name not in noise}, units),
        "prior": prior(numbers.before, unit),
        "traces": traces(draws, units),
    }


def cycle(runs: Runs, unit: ForceUnit) -> str:
    """One cycle of each run: measured points, median of the law and the band of what would be measured."""
    figure, axes = sheet(NARROW, 295)
    for (run, band), colour in zip(runs, SERIES, strict=False):
        at = pick_cycle(run)
        x = run.displacement_mm[at]
        # A loop is two curves over the same stroke; one ribbon along the path covers both.
        axes.fill(x, band.force_low[at], band.force_high[at], color=colour, alpha=0.22)
        axes.plot(x, run.force_kN[at], ".", size=2.4, alpha=0.8)
        axes.plot(x, band.median[at], color=colour, linewidth=1.3, label=f"run {run.number}: model")
    axes.plot([], [], ".", label="measured")
    axes.fill([], [], [], color=GREY, alpha=0.3, label="90 % of points expected")
    return drawn(figure, STROKE, FORCE, 2, unit)


def all_cycles(run: RunData, band: Band, unit: ForceUnit) -> str:
    """All cycles of one run, measured over predicted."""
    figure, axes = sheet()
    x = run.displacement_mm
    step = max(1, x.size // MAX_POINTS)
    # Half-cycle by half-cycle: as one shape, ribbons that lie over one another would cancel.
    for a, b in pairwise([*run.starts.tolist(), x.size]):
        part = slice(a, b, step)
        axes.fill(x[part], band.force_low[part], band.force_high[part], color=BLUE, alpha=0.12)
    axes.plot(x[::step], run.force_kN[::step], linewidth=0.6, alpha=0.8, label="measured")
    axes.plot(x[::step], band.median[::step], color=RED, linewidth=0.8, label="model (median)")
    axes.fill([], [], [], color=BLUE, alpha=0.3, label="90 % band")
    return drawn(figure, STROKE, FORCE, 3, unit)


def over_time(run: RunData, band: Band, unit: ForceUnit) -> str:
    """Force over time of one run, measured and modelled, and the residual below it with the band of the noise."""
    figure = Figure(WIDE, 330, (3, 2))
    (above, below), time_s = figure.axes, run.time_s
    left, noise = run.force_kN - band.median, run.predicted_kN - run.law_kN
    low, high = np.quantile(noise[:: max(1, noise.shape[0] // 20)], (0.05, 0.95))
    above.plot(*extremes(time_s, run.force_kN), linewidth=0.8, label="measured")
    above.plot(*extremes(time_s, band.median), color=RED, linewidth=0.7, label="model (median)")
    below.fill([-np.inf, np.inf], low, high, color=BLUE, alpha=0.15, label="noise of the fit (90 %)")
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


def channels(run: RunData, units: Mapping[str, str]) -> tuple[str, int, str, bool] | None:
    """Further channels of a run over time, and their names; whether the force over the bolt tension is among them."""
    extras = [
        (f"{name} ({units[name]})" if units.get(name) else name, values)
        for name, values in run.extras.items()
        if np.isfinite(values).any()
    ]
    tension = run.extras.get(TENSION)
    if tension is not None and units.get(TENSION) == "kN":
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(run.force_kN) / tension
        extras.append(("mu = F/N", np.where(tension > 0, ratio, np.nan)))
    if not extras:
        return None
    figure = Figure(WIDE, 108 * len(extras) + 43, [1] * len(extras))
    for axes, (title, values) in zip(figure.axes, extras, strict=True):
        axes.plot(*extremes(run.time_s, values), color=BLUE, linewidth=0.9)
        label(axes, "", title)
        axes.x_numbers = 0
    alike(figure.axes, x=True)
    figure.axes[-1].x_title, figure.axes[-1].x_numbers = "time (s)", None
    return svg(figure), run.number, ", ".join(title for title, _ in extras), len(extras) > len(run.extras)


def over_speed(runs: Runs, unit: ForceUnit) -> str:
    """Force over velocity: measured points and the model's."""
    figure, axes = sheet()
    for (run, band), colour in zip(runs, SERIES, strict=False):
        speed = run.direction * run.speed_mm_s
        keep = slice(None, None, max(1, speed.size // MAX_OVER_SPEED))
        axes.plot(speed[keep], run.force_kN[keep], ".", size=2.2, alpha=0.5)
        axes.plot(speed[keep], band.median[keep], ".", color=colour, size=2.2, alpha=0.6)
        axes.plot([], [], ".", color=colour, size=7, label=f"run {run.number}: model")
    axes.plot([], [], ".", size=7, label="measured")
    return drawn(figure, "velocity (mm/s)", FORCE, 3, unit)


def _numbered(cycles: Sequence[Cycles]) -> Iterator[tuple[Cycles, str, FloatArray]]:
    """Cycles of each run with a colour and the numbers that they have among those of all runs."""
    at = 0
    for one, colour in zip(cycles, SERIES, strict=False):
        yield one, colour, at + np.arange(1.0, one.measured_J.size + 1)
        at += one.measured_J.size


def _over_cycles(figure: Figure, y: str, columns: int, unit: ForceUnit = KN) -> str:
    """Titles and key of a diagram over the cycles."""
    figure.axes[0].whole = True
    return drawn(figure, "cycle, in the order they were made", y, columns, unit)


def energy(cycles: Sequence[Cycles]) -> str:
    """Energy of every cycle, measured and predicted."""
    figure, axes = sheet()
    largest = max(float(e.measured_J.max()) for e in cycles)
    unit, factor = ("kJ", 1e-3) if largest >= 1000 else ("J", 1.0)
    for e, colour, number in _numbered(cycles):
        bars = np.stack([e.low_J, e.high_J, np.full(number.size, np.nan)], axis=1).ravel() * factor
        axes.plot(np.repeat(number, 3), bars, color=colour, linewidth=2)
        axes.plot(number, e.median_J * factor, "_", color=colour, size=13, label=f"run {e.run}: model, 90 %")
        axes.plot(number, e.measured_J * factor, "o", hollow=True)
    axes.plot([], [], "o", hollow=True, label="measured")
    axes.from_zero()
    return _over_cycles(figure, f"energy of the cycle ({unit})", 2)


def envelope(cycles: Sequence[Cycles], unit: ForceUnit) -> str:
    """Largest and sliding force of every cycle, push and pull."""
    figure, axes = sheet()
    for c, colour, number in _numbered(cycles):
        for sign, peak, flat in ((1, c.push_kN, c.push_sliding_kN), (-1, c.pull_kN, c.pull_sliding_kN)):
            marker = "^" if sign > 0 else "v"
            axes.plot(number, sign * peak, marker, color=colour, hollow=True)
            axes.plot(number, sign * flat, f"{marker}-", color=colour, linewidth=1)
        axes.plot([], [], "-", color=colour, label=f"run {c.run}")
    axes.plot([], [], "^", label="push")
    axes.plot([], [], "v", label="pull")
    axes.from_zero()
    return _over_cycles(figure, FORCE, 4, unit)


def damping(cycles: Sequence[Cycles]) -> str:
    """Equivalent viscous damping of every cycle, measured and modelled."""
    figure, axes = sheet()
    for c, colour, number in _numbered(cycles):
        axes.plot(number, c.model_damping_percent, "_", color=colour, size=13, label=f"run {c.run}: model")
        axes.plot(number, c.damping_percent, "o", hollow=True)
    axes.plot([], [], "o", hollow=True, label="measured")
    axes.from_zero(70)
    return _over_cycles(figure, "equivalent damping (%)", 3)


def backbone(cycles: Sequence[Cycles], unit: ForceUnit) -> str:
    """Force where the cycles turn, measured and modelled, in the order of the displacement there."""
    figure, axes = sheet()
    for c, colour in zip(cycles, SERIES, strict=False):
        order = np.argsort(c.turn_mm)
        axes.plot(c.turn_mm[order], c.model_turn_kN[order], color=colour, linewidth=1.3)
        axes.plot(c.turn_mm, c.turn_kN, "o", color=colour, hollow=True)
        axes.plot([], [], "o-", color=colour, label=f"run {c.run}")
    return drawn(figure, STROKE, FORCE, 3, unit)


def prior(b: Beforehand, unit: ForceUnit) -> str:
    """Loops that the priors allow, those of the published devices (of which there may be none), and what is left."""
    figure, axes = sheet(WIDE, 281)
    x = b.displacement_mm
    groups = (
        (b.prior_kN, PALE, 0.6, "allowed before the test"),
        (b.paper_kN, GREEN, 0.9, "devices of the published tables"),
        (b.posterior_kN, BLUE, 1.6, "this device, after the test"),
    )
    for forces, colour, width, words in groups:
        if forces.size:
            lines = np.pad(forces, ((0, 0), (0, 1)), constant_values=np.nan)
            along = np.tile(np.append(x, np.nan), len(forces))
            axes.plot(along, lines.ravel(), color=colour, linewidth=width, alpha=0.8, label=words)
    axes.x_range = (1.05 * x.min(), 1.05 * x.max())
    reach = 1.15 * float(np.quantile(np.abs(b.prior_kN).max(axis=1), 0.97))
    reach = max(reach, 1.1 * float(np.abs(b.posterior_kN).max()))
    axes.y_range = (-reach, reach)
    return drawn(figure, STROKE, FORCE, 3, unit)


def over_stroke(profiles: Sequence[StrokeProfile], unit: ForceUnit) -> str:
    """Mean residual over stroke, push and pull of one run, with what noise alone would give."""
    figure, axes = sheet(NARROW, 230)
    kinds = ((BLUE, "o-", "displacement growing"), (RED, "s-", "displacement falling"))
    for profile, (colour, style, name) in zip(profiles, kinds, strict=True):
        axes.fill(profile.centre_mm, profile.low_kN, profile.high_kN, color=colour, alpha=0.16)
        axes.plot(profile.centre_mm, profile.mean_kN, style, color=colour, size=4, linewidth=1.2, label=name)
    axes.fill([], [], [], color=GREY, alpha=0.3, label="noise alone (90 %)")
    axes.across(0)
    return drawn(figure, STROKE, "mean residual (kN)", 2, unit)


def corner(draws: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Draws, shape (n,), of every parameter against every other; under gamma stands dep = 1/gamma."""
    names, side = list(draws), max(259.0 / len(draws), 86.0)
    size = 84 + side * len(names)
    figure = Figure(size, size, [1] * len(names), len(names), gap=(4, 4), left=72, bottom=72)
    spans = {name: _span(column) for name, column in draws.items()}
    shown = []
    for place, axes in enumerate(figure.axes):
        i, j = divmod(place, len(names))
        if j > i:
            continue
        shown.append(axes)
        x, y = draws[names[j]], draws[names[i]]
        axes.x_range, axes.grid, axes.size, axes.x_numbers, axes.y_numbers = spans[names[j]], False, 7.5, 0, 0
        if i == j:
            heights, edges = np.histogram(x, BINS, spans[names[i]])
            axes.plot(np.repeat(edges, 2), [0.0, *np.repeat(heights, 2), 0.0], color=BLUE, linewidth=1.2)
            axes.from_zero()
        else:
            axes.y_range = spans[names[i]]
            some = np.linspace(0, x.size - 1, min(MAX_DOTS, x.size)).astype(int)
            axes.plot(x[some], y[some], ".", color=BLUE, size=1.6, alpha=0.3)
            for lines in _contours(x, y, spans[names[j]], spans[names[i]]):
                axes.plot(*lines, color=BLUE, linewidth=0.9)
        if i == len(names) - 1:
            axes.x_numbers, axes.x_title = 2, names[j] + ("" if units[names[j]] == "1" else f"\n{units[names[j]]}")
            if base_of(names[j]) == "gamma":
                axes.x_words, axes.x_title = _gamma_and_dep, f"\n{names[j]} s/mm\n(dep mm/s)"
        if j == 0 and i:
            axes.y_title, axes.y_numbers = _named(names[i], units), 3
    figure.axes = shown
    return svg(figure)


def _contours(
    x: FloatArray, y: FloatArray, x_span: tuple[float, float], y_span: tuple[float, float]
) -> list[FloatArray]:
    """Lines that hold `SHARES` of the draws, each shape (2, n), pieces between numbers that are none."""
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS, (x_span, y_span))
    weights = np.exp(-0.5 * np.arange(-REACH, REACH + 1) ** 2)
    for axis in (0, 1):
        counts = np.apply_along_axis(np.convolve, axis, counts, weights / weights.sum(), "same")
    ordered = np.sort(counts, axis=None)[::-1]
    held = np.cumsum(ordered) / ordered.sum()
    across, up = (0.5 * (edges[1:] + edges[:-1]) for edges in (x_edges, y_edges))
    return [_level(across, up, counts, float(ordered[np.searchsorted(held, share)])) for share in SHARES]


def _level(x: FloatArray, y: FloatArray, heights: FloatArray, level: float) -> FloatArray:
    """Where a surface has a height: a piece through each triangle, two for each field, whose corners lie about it."""
    corner = np.stack(np.broadcast_arrays(x[:, None], y, heights - level))
    a, b, c, d = corner[:, :-1, :-1], corner[:, 1:, :-1], corner[:, :-1, 1:], corner[:, 1:, 1:]
    tri = np.stack([np.concatenate([one.reshape(3, -1) for one in pair], axis=1) for pair in ((a, d), (b, b), (c, c))])
    ends = []
    for one, two in ((0, 1), (1, 2), (2, 0)):
        p, q = tri[one], tri[two]
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = p[:2] + (q[:2] - p[:2]) * p[2] / (p[2] - q[2])
        ends.append(np.where((p[2] > 0) != (q[2] > 0), cut, np.nan))
    found = np.stack(ends, axis=2)  # each triangle that is cut has two ends
    found = found[:, np.isfinite(found[0]).sum(axis=1) == 2]
    pairs = np.stack([part[np.isfinite(part)].reshape(-1, 2) for part in found])
    return np.pad(pairs, ((0, 0), (0, 0), (0, 1)), constant_values=np.nan).reshape(2, -1)


def _span(column: FloatArray) -> tuple[float, float]:
    """Range that shows nearly all draws, also of a parameter that does not move."""
    low, high = (float(v) for v in np.quantile(column, (0.002, 0.998)))
    return (low, high) if high > low else (low - 1e-9 - abs(low) * 1e-6, high + 1e-9 + abs(high) * 1e-6)


def _gamma_and_dep(value: float) -> str:
    """Write gamma with dep = 1/gamma in brackets; no speed dependence has no dep."""
    return f"{value:.4g}\n({1 / value:+.4g})" if abs(value) > 1e-9 else "0\n(none)"


def densities(device: DeviceData, unit: ForceUnit, draws: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Posterior of every parameter beside its prior, in the unit shown."""
    laws = [Prior(**vars(row)) for row in device.record.prior_laws]
    rows = -(-len(laws) // 4)
    figure = Figure(WIDE, 126 * rows + 22, [1] * rows, 4, gap=(12, 40), left=14, top=25)
    figure.axes = figure.axes[: len(laws)]
    for axes, law in zip(figure.axes, laws, strict=True):
        factor, values = unit.of(law.unit)[1], draws[law.name].ravel()
        low, high = np.quantile(values, (0.001, 0.999))
        room = 0.5 * (high - low) or 1e-6 * abs(high) or 1e-6
        least, most = (factor * edge for edge in law.support)
        places = np.linspace(max(low - room, least + 1e-6 * room), min(high + room, most - 1e-6 * room), 160)
        heights, edges = np.histogram(values, 40, (places[0], places[-1]), density=True)
        axes.fill(np.repeat(edges, 2), 0.0, np.pad(np.repeat(heights, 2), 1), color=BLUE, alpha=0.55, label="posterior")
        axes.plot(places, np.exp(law.log_density(places / factor)) / factor, "--", linewidth=1.2, label="prior")
        axes.from_zero()
        axes.x_range = (places[0], places[-1])
        axes.size, axes.x_numbers, axes.y_numbers, axes.grid = 8, 3, 0, False
        axes.x_title = _named(law.name, units).replace("\n", " ")
    for axes in figure.axes[1:]:
        axes.key = []
    figure.axes[0].columns = 2
    return svg(figure)


def traces(chains: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Where the walkers were, step by step, one colour for each ensemble.

    Draws in the order in which they were made, walkers after one another: shape (n_ensembles, n_draws).
    """
    figure = Figure(WIDE, 61 * len(chains) + 43, [1] * len(chains), left=72)
    for axes, (name, paths) in zip(figure.axes, chains.items(), strict=True):
        for path, colour in zip(paths, SERIES, strict=False):
            some = np.linspace(0, path.size - 1, min(MAX_STEPS, path.size)).astype(int)
            axes.plot(100.0 * some / max(path.size - 1, 1), path[some], ".", color=colour, size=3.6, alpha=0.6)
        axes.x_range, axes.x_numbers, axes.y_numbers, axes.size = (0.0, 100.0), 0, 2, 8
        axes.y_title = _named(name, units)
    figure.axes[-1].x_numbers, figure.axes[-1].x_title = None, "steps kept (%)"
    return svg(figure)


def _named(name: str, units: Mapping[str, str]) -> str:
    return name if units[name] == "1" else f"{name}\n({units[name]})"
