"""Loops, energy and degradation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.data import IntArray
from shj_bayes.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    NARROW,
    PALE,
    RED,
    SERIES,
    WIDE,
    label,
    legend,
    sheet,
    svg,
)
from shj_bayes.report.numbers import Band, CycleEnergy, Degradation

STROKE, FORCE = "displacement (mm)", "force (kN)"
MAX_POINTS = 20_000


def cycle(parts: Sequence[tuple[str, FloatArray, FloatArray, Band]], *, wide: bool = False) -> str:
    """One cycle of each run: measured points, median of the law and the band of what would be measured.

    Parameters
    ----------
    parts : sequence of (name, displacement, force, Band)
        One for each run, arrays of shape (n,).
    wide : bool
        Full width of the page.
    """
    figure, axes = sheet(WIDE if wide else NARROW, 3.9 if wide else 4.1)
    for (name, x, force, band), colour in zip(parts, SERIES, strict=False):
        # A loop is two curves over the same stroke; one ribbon along the path covers both.
        axes.fill_between(x, band.force_low, band.force_high, color=colour, alpha=0.22, linewidth=0, rasterized=True)
        axes.plot(x, force, ".", color=INK, markersize=2.4, alpha=0.8, markeredgewidth=0, rasterized=True)
        axes.plot(x, band.median, color=colour, linewidth=1.3, label=f"{name}: model")
    axes.plot([], [], ".", color=INK, markersize=6, label="measured")
    axes.fill_between([], [], [], color=GREY, alpha=0.3, label="90 % of points expected")
    label(axes, STROKE, FORCE)
    legend(axes, 2)
    return svg(figure)


def all_cycles(x: FloatArray, force: FloatArray, band: Band, starts: IntArray) -> str:
    """All cycles of one run, measured over predicted; `starts` are the first samples of the half-cycles."""
    figure, axes = sheet()
    step = max(1, x.size // MAX_POINTS)
    # Half-cycle by half-cycle: as one shape, ribbons that lie over one another would cancel.
    for a, b in pairwise([*starts.tolist(), x.size]):
        part = slice(a, b, step)
        axes.fill_between(
            x[part], band.force_low[part], band.force_high[part], color=BLUE, alpha=0.12, linewidth=0, rasterized=True
        )
    keep = slice(None, None, step)
    axes.plot(x[keep], force[keep], color=INK, linewidth=0.6, alpha=0.8, label="measured", rasterized=True)
    axes.plot(x[keep], band.median[keep], color=RED, linewidth=0.8, label="model (median)", rasterized=True)
    axes.fill_between([], [], [], color=BLUE, alpha=0.3, label="90 % band")
    label(axes, STROKE, FORCE)
    legend(axes, 3)
    return svg(figure)


def energy(energies: Sequence[CycleEnergy]) -> str:
    """Energy of every cycle, measured and predicted."""
    figure, axes = sheet(WIDE, 3.3)
    largest = max(float(e.measured_J.max()) for e in energies)
    unit, factor = ("kJ", 1e-3) if largest >= 1000 else ("J", 1.0)
    at = 0
    for e, colour in zip(energies, SERIES, strict=False):
        number = at + np.arange(1, e.measured_J.size + 1)
        middle = e.median_J * factor
        error = np.stack([(e.median_J - e.low_J), (e.high_J - e.median_J)]) * factor
        axes.errorbar(
            number, middle, _lengths(error), fmt="_", color=colour, markersize=13, capsize=5, elinewidth=2,
            label=f"run {e.run}: predicted, 90 % band",
        )  # fmt: skip
        axes.plot(
            number, e.measured_J * factor, "o", color=INK, markersize=4.5, markerfacecolor="none", markeredgewidth=1.2
        )
        at += e.measured_J.size
    axes.plot([], [], "o", color=INK, markersize=4.5, markerfacecolor="none", label="measured")
    axes.set_ylim(bottom=0)
    label(axes, "cycle, in the order they were made", f"energy of the cycle ({unit})")
    legend(axes, 3)
    return svg(figure)


def energy_error(energies: Sequence[CycleEnergy]) -> str:
    """Predicted less measured energy, per cent of the measured."""
    figure, axes = sheet(WIDE, 2.6)
    at = 0
    for e, colour in zip(energies, SERIES, strict=False):
        number = at + np.arange(1, e.measured_J.size + 1)
        low, middle, high = (100 * (v / e.measured_J - 1) for v in (e.low_J, e.median_J, e.high_J))
        axes.errorbar(
            number, middle, _lengths(np.stack([middle - low, high - middle])), fmt="o", color=colour, markersize=4,
            capsize=3, label=f"run {e.run}",
        )  # fmt: skip
        at += e.measured_J.size
    axes.axhline(0, color=INK, linewidth=1)
    label(axes, "cycle, in the order they were made", "predicted minus\nmeasured energy (%)")
    legend(axes, 3)
    return svg(figure)


def _lengths(error: FloatArray) -> FloatArray:
    """Lengths of error bars, never negative."""
    return np.maximum(np.abs(error), 0.0)


def degradation(losses: Sequence[Degradation]) -> str:
    """Posterior of the loss of sliding force against the first run."""
    figure, axes = sheet(NARROW, 2.9)
    for loss, colour in zip(losses, SERIES, strict=False):
        axes.hist(loss.loss_percent, bins=60, density=True, color=colour, alpha=0.35, label=f"run {loss.run}")
        axes.axvline(loss.q50, color=colour, linewidth=1.6)
        for edge in (loss.q05, loss.q95):
            axes.axvline(edge, color=colour, linewidth=1, linestyle="--")
    axes.set_yticks([])
    label(axes, "loss of sliding force against the first run (%)", "how likely")
    legend(axes, 3)
    return svg(figure)


def prior(x: FloatArray, prior_kN: FloatArray, paper_kN: FloatArray, posterior_kN: FloatArray) -> str:
    """Loops that the priors allow, those of the published devices, and what is left after the test.

    Parameters
    ----------
    x : array, shape (n,)
        Displacement of one closed cycle, mm.
    prior_kN, paper_kN, posterior_kN : array, shape (m, n)
        Forces; ``paper_kN`` may have no rows.
    """
    figure, axes = sheet(WIDE, 3.9)
    axes.plot(x, prior_kN.T, color=PALE, linewidth=0.6, alpha=0.8, rasterized=True)
    if paper_kN.size:
        axes.plot(x, paper_kN.T, color=GREEN, linewidth=0.9, alpha=0.8, rasterized=True)
    axes.plot(x, posterior_kN.T, color=BLUE, linewidth=1.6, alpha=0.9, rasterized=True)
    axes.plot([], [], color=PALE, label="allowed before the test")
    if paper_kN.size:
        axes.plot([], [], color=GREEN, label="devices of the published tables")
    axes.plot([], [], color=BLUE, linewidth=2, label="this device, after the test")
    reach = 1.15 * float(np.quantile(np.abs(prior_kN).max(axis=1), 0.97))
    reach = max(reach, 1.1 * float(np.abs(posterior_kN).max()))
    axes.set_ylim(-reach, reach)
    label(axes, STROKE, FORCE)
    legend(axes, 3)
    return svg(figure)
