"""Corner plot, traces and ranks."""

from __future__ import annotations

from collections.abc import Mapping

import corner as corner_package
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.figures.canvas import BLUE, INK, SERIES, WIDE, label, png, svg, tidy

MAX_DRAWS, MAX_STEPS = 8000, 300


def corner(draws: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Every parameter against every other; under gamma stands dep = 1/gamma.

    Parameters
    ----------
    draws : mapping of str to array, shape (n,)
        Posterior draws.
    units : mapping of str to str
        Unit of each, ``"1"`` for none.
    """
    names = list(draws)
    table = np.stack([draws[name] for name in names], axis=1)
    table = table[np.linspace(0, table.shape[0] - 1, min(MAX_DRAWS, table.shape[0])).astype(int)]
    spans = [_span(column) for column in table.T]
    size = max(4.5, 1.25 * len(names))
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
    figure.subplots_adjust(left=0.1, bottom=0.12, right=0.99, top=0.99)
    return png(figure, 110)


def _span(column: FloatArray) -> tuple[float, float]:
    """Range that shows nearly all draws, also of a parameter that does not move."""
    low, high = (float(v) for v in np.quantile(column, (0.002, 0.998)))
    return (low, high) if high > low else (low - 1e-9 - abs(low) * 1e-6, high + 1e-9 + abs(high) * 1e-6)


def _gamma_and_dep(value: float, _: object = None) -> str:
    """Tick of the gamma axis with dep = 1/gamma in brackets; no speed dependence has no dep."""
    return f"{value:.4g}\n({1 / value:+.4g})" if abs(value) > 1e-9 else "0\n(none)"


def traces(means: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Mean over the walkers of each ensemble along its path.

    Parameters
    ----------
    means : mapping of str to array, shape (n_ensembles, n_steps)
        In natural units.
    units : mapping of str to str
        Unit of each.
    """
    figure = Figure(figsize=(WIDE / 2, 1.0 * len(means) + 0.4), layout="constrained")
    panels = figure.subplots(len(means), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, paths) in zip(panels, means.items(), strict=True):
        tidy(axes)
        every = max(1, paths.shape[1] // MAX_STEPS)
        for path, colour in zip(paths[:, ::every], SERIES, strict=False):
            axes.plot(1 + every * np.arange(path.size), path, color=colour, linewidth=0.7)
        axes.yaxis.set_major_locator(MaxNLocator(3))
        axes.tick_params(labelsize=8)
        axes.set_ylabel(_named(name, units), fontsize=9)
    label(panels[-1], "stored step (number)", _named(list(means)[-1], units))
    panels[-1].yaxis.label.set_size(9)
    return png(figure, 115)


def ranks(shares: Mapping[str, tuple[FloatArray, float]]) -> str:
    """Rank histogram of each ensemble, for each parameter."""
    figure = Figure(figsize=(WIDE / 2, 1.0 * len(shares) + 0.4), layout="constrained")
    panels = figure.subplots(len(shares), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, (rows, margin)) in zip(panels, shares.items(), strict=True):
        tidy(axes)
        axes.axhspan(max(0.0, 1 - margin), 1 + margin, color=INK, alpha=0.1, linewidth=0)
        edges = np.linspace(0, 100, rows.shape[1] + 1)
        for row, colour in zip(rows, SERIES, strict=False):
            axes.stairs(row, edges, color=colour, linewidth=1.1)
        axes.set_ylim(0, max(2.0, 1.1 * float(rows.max())))
        axes.tick_params(labelsize=8)
        axes.set_ylabel(name, fontsize=9)
    label(panels[-1], "rank among all draws (%)", panels[-1].get_ylabel())
    panels[-1].yaxis.label.set_size(9)
    return svg(figure)


def _named(name: str, units: Mapping[str, str]) -> str:
    return name if units[name] == "1" else f"{name}\n({units[name]})"
