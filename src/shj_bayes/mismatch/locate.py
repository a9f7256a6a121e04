"""Where the base law fails: regions, sizes and chances, from a calibrated look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shj_bayes.mismatch.calibrate import Alarm
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Refit
from shj_bayes.mismatch.regions import Region, Regions
from shj_bayes.model.parameters import FloatArray

LISTED = 8  # regions in a list for people; the page draws them all
SURE = 0.05


@dataclass(frozen=True)
class Location:
    """One region in which the law fails.

    Parameters
    ----------
    region : Region
        Coordinate, interval, direction.
    runs : tuple of int
        Runs in which it is seen.
    size_kN : float
        Mean residual there (direction-signed for ``both``), kN.
    share : float
        Part of the residual's sum of squares that lies in the region, of the part that is not noise.
    p_value : float
        Corrected for all regions and effects looked at.
    """

    region: Region
    runs: tuple[int, ...]
    size_kN: float
    share: float
    p_value: float


def locate(evidence: Evidence, fit: Refit, regions: Regions, alarm: Alarm, noise_kN: float) -> list[Location]:
    """List the regions in which a fit fails, the largest first, at most two for each coordinate.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    fit : Refit
        The fit whose residual is mapped.
    regions : Regions
        What was looked at; the first columns of the look.
    alarm : Alarm
        The look.
    noise_kN : float
        Noise floor, kN: what is above it is explainable.

    Returns
    -------
    list of Location
    """
    residual = fit.residual_kN
    excess = max(float(residual @ residual) - noise_kN**2 * float(evidence.weight.sum()), 1e-12)
    out = []
    for i, region in enumerate(regions.regions):
        column = regions.columns[:, i]
        inside = np.flatnonzero(column)
        p = float(alarm.p_of_each[i])
        mean = float(column[inside] @ residual[inside]) / inside.size
        own = float(residual[inside] @ residual[inside]) - noise_kN**2 * inside.size
        share = float(np.clip(own / excess, 0.0, 1.0))
        out.append(Location(region, _runs(evidence, residual, inside), mean, share, p))
    kept: list[Location] = []
    for location in sorted(out, key=lambda where: (where.p_value > SURE, -abs(where.size_kN))):
        same = sum(k.region.coordinate == location.region.coordinate for k in kept)
        if location.p_value <= SURE and same < 2 and len(kept) < LISTED:
            kept.append(location)
    return kept


def largest_region(evidence: Evidence, fit: Refit, regions: Regions, alarm: Alarm) -> tuple[float, Region | None]:
    """Largest mean residual of the regions in which chance is excluded, kN, and where."""
    best, where = 0.0, None
    for i, region in enumerate(regions.regions):
        inside = np.flatnonzero(regions.columns[:, i])
        mean = abs(float(regions.columns[inside, i] @ fit.residual_kN[inside]) / inside.size)
        if alarm.p_of_each[i] <= SURE and mean > best:
            best, where = mean, region
    return best, where


def profile(
    evidence: Evidence, residual: FloatArray, coordinate: str, n_bins: int = 24
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean residual over one coordinate, push and pull.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    residual : array, shape (n,)
        kN.
    coordinate : str
        ``position``, ``speed``, ``slip since reversal``, ``travel``, ``amplitude`` or ``run``.
    n_bins : int
        Number of intervals.

    Returns
    -------
    centres, push, pull : array, shape (n_bins,)
        Coordinate; mean residual in kN (nan where there is none).
    """
    name = {
        "position": "position_mm",
        "speed": "speed_mm_s",
        "slip since reversal": "slip_mm",
        "travel": "travel_m",
        "amplitude": "amplitude_mm",
    }.get(coordinate)
    values = evidence.stack(name) if name else evidence.run.astype(np.float64)
    edges = np.linspace(values.min(), values.max() * (1 + 1e-9) + 1e-9, n_bins + 1)
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, n_bins - 1)
    sense = evidence.stack("direction")
    means = []
    for sign in (1.0, -1.0):
        own = (sense == sign) & (evidence.weight > 0)
        count = np.bincount(index[own], minlength=n_bins)
        total = np.bincount(index[own], weights=residual[own], minlength=n_bins)
        means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    return (edges[:-1] + edges[1:]) / 2, means[0], means[1]


def _runs(evidence: Evidence, residual: FloatArray, inside: NDArray[np.intp]) -> tuple[int, ...]:
    """List runs that hold at least a tenth of the region's sum of squares."""
    run = evidence.run[inside]
    power = np.bincount(run, weights=residual[inside] ** 2)
    return tuple(int(i) for i in np.flatnonzero(power >= 0.1 * power.sum()) if i > 0)
