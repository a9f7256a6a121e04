"""Corner plot, densities and traces."""

from collections.abc import Mapping

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, SERIES, WIDE, Axes, Figure, svg

BINS, REACH, SHARES = (
    24,
    3,
    (0.5, 0.9),
)  # of a corner plot; bins that its smoothing goes to each side; held by the lines
MAX_DOTS, MAX_STEPS = 300, 250  # of each panel of a corner plot; of the trace of an ensemble


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
            _along(axes, names[j], units[names[j]])
        if j == 0 and i:
            axes.y_title, axes.y_numbers = _named(names[i], units), 3
    figure.axes = shown
    return svg(figure)


def _along(axes: Axes, name: str, unit: str) -> None:
    """Numbers and title below a column."""
    axes.x_numbers, axes.x_title = 2, name + ("" if unit == "1" else f"\n{unit}")
    if name.partition("_")[0] == "gamma":
        axes.x_numbers, axes.x_words, axes.x_title = 2, _gamma_and_dep, f"\n{name} s/mm\n(dep mm/s)"


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


def densities(parts: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]], units: Mapping[str, str]) -> str:
    """Posterior of every parameter beside its prior: draws, places and prior density there, in the unit shown."""
    rows = -(-len(parts) // 4)
    figure = Figure(WIDE, 126 * rows + 22, [1] * rows, 4, gap=(12, 40), left=14, top=25)
    for axes, (name, (draws, places, density)) in zip(figure.axes, parts.items(), strict=False):
        heights, edges = np.histogram(draws, 40, (places[0], places[-1]), density=True)
        steps = np.pad(np.repeat(heights, 2), 1)
        axes.fill(np.repeat(edges, 2), 0.0, steps, color=BLUE, alpha=0.55, label="posterior")
        axes.plot(places, density, "--", linewidth=1.2, label="prior")
        axes.from_zero()
        axes.x_range = (places[0], places[-1])
        axes.size, axes.x_numbers, axes.y_numbers, axes.grid = 8, 3, 0, False
        axes.x_title = _named(name, units).replace("\n", " ")
    figure.axes = figure.axes[: len(parts)]
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
