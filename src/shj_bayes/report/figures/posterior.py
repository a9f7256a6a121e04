"""Corner plot, traces and ranks."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from shj_bayes._util.imports import without
from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, INK, SERIES, WIDE, fixed, label, png, svg, tidy

with without("arviz"):
    import corner as corner_package

MAX_DRAWS = 8000
CORNER, EDGE = 1.0, 0.15  # inches: room for the slanted numbers and titles left of and below a corner plot, and right


def corner(draws: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Draws, shape (n,), of every parameter against every other; under gamma stands dep = 1/gamma."""
    names = list(draws)
    table = np.stack([draws[name] for name in names], axis=1)
    table = table[np.linspace(0, table.shape[0] - 1, min(MAX_DRAWS, table.shape[0])).astype(int)]
    spans = [_span(column) for column in table.T]
    size = CORNER + max(3.6, 1.2 * len(names))
    figure = Figure(figsize=(size, size))
    corner_package.corner(
        table,
        fig=figure,
        range=spans,
        bins=24,
        color=BLUE,
        plot_datapoints=False,
        smooth=1.0,
        levels=(0.5, 0.9),
        hist_kwargs={"linewidth": 1.2},
        contour_kwargs={"linewidths": 0.9},
        quiet=True,
        labelpad=0.12,
        max_n_ticks=3,
    )
    axes = np.array(figure.axes).reshape(len(names), len(names))
    for i, name in enumerate(names):
        unit = "" if units[name] == "1" else f"\n{units[name]}"
        axes[-1, i].set_xlabel(name + unit, fontsize=9.5)
        if i:
            axes[i, 0].set_ylabel(name + unit, fontsize=9.5)
        for panel in (*axes[i, : i + 1], *axes[i:, i]):
            panel.tick_params(labelsize=7.5, length=2)
        if name.partition("_")[0] == "gamma":
            axes[-1, i].xaxis.set_major_formatter(FuncFormatter(_gamma_and_dep))
            axes[-1, i].xaxis.set_major_locator(MaxNLocator(2, prune="lower"))
            axes[-1, i].set_xlabel(f"{name} s/mm\n(dep mm/s)", fontsize=9.5)
    figure.subplots_adjust(left=CORNER / size, bottom=CORNER / size, right=1.0 - EDGE / size, top=0.99)
    return png(figure, 110)


def _span(column: FloatArray) -> tuple[float, float]:
    """Range that shows nearly all draws, also of a parameter that does not move."""
    low, high = (float(v) for v in np.quantile(column, (0.002, 0.998)))
    return (low, high) if high > low else (low - 1e-9 - abs(low) * 1e-6, high + 1e-9 + abs(high) * 1e-6)


def _gamma_and_dep(value: float, _: object = None) -> str:
    """Tick of the gamma axis with dep = 1/gamma in brackets; no speed dependence has no dep."""
    return f"{value:.4g}\n({1 / value:+.4g})" if abs(value) > 1e-9 else "0\n(none)"


def densities(parts: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]], units: Mapping[str, str]) -> str:
    """Posterior of every parameter beside its prior: draws, places and prior density there, in the unit shown."""
    columns = 4
    rows = -(-len(parts) // columns)
    figure = fixed(WIDE, 1.75 * rows + 0.3, left=0.2, top=0.35)
    panels = figure.subplots(rows, columns, squeeze=False, gridspec_kw={"wspace": 0.12, "hspace": 0.45}).ravel()
    for axes, (name, (draws, places, density)) in zip(panels, parts.items(), strict=False):
        tidy(axes)
        axes.grid(visible=False)
        # One shape: forty bars take as long to make as all else in the diagram.
        look = {"histtype": "stepfilled", "color": BLUE, "alpha": 0.55, "label": "posterior"}
        axes.hist(draws, bins=40, range=(places[0], places[-1]), density=True, **look)
        axes.plot(places, density, color=INK, linewidth=1.2, linestyle="--", label="prior")
        axes.set_yticks([])
        axes.xaxis.set_major_locator(MaxNLocator(3))
        axes.tick_params(labelsize=8)
        axes.set_xlabel(_named(name, units).replace("\n", " "), fontsize=9)
    for axes in panels[len(parts) :]:
        axes.set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="upper left", ncols=2, frameon=False, fontsize=9)
    return svg(figure)


def traces(chains: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Where the walkers were, step by step, one colour for each ensemble.

    Draws in the order in which they were made, walkers after one another: shape (n_ensembles, n_draws).
    """
    figure = fixed(WIDE, 0.85 * len(chains) + 0.6, left=1.0)
    panels = figure.subplots(len(chains), 1, sharex=True, squeeze=False, gridspec_kw={"hspace": 0.2})[:, 0]
    for axes, (name, paths) in zip(panels, chains.items(), strict=True):
        tidy(axes)
        for path, colour in zip(paths, SERIES, strict=False):
            place = np.linspace(0, 100, path.size)
            axes.plot(place, path, ".", color=colour, markersize=3.6, markeredgewidth=0, alpha=0.6)
        axes.set_xlim(0, 100)
        axes.yaxis.set_major_locator(MaxNLocator(3))
        axes.tick_params(labelsize=8)
        axes.set_ylabel(_named(name, units), fontsize=9)
    label(panels[-1], "steps kept (%)", _named(list(chains)[-1], units))
    panels[-1].yaxis.label.set_size(9)
    return png(figure, 115)


def _named(name: str, units: Mapping[str, str]) -> str:
    return name if units[name] == "1" else f"{name}\n({units[name]})"
