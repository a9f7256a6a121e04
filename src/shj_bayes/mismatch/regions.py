"""Regions of a recording in which a misfit may sit, as columns that a residual can be compared with."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.model.parameters import FloatArray

MIN_SHARE = 0.01  # of the samples that a region must hold to be looked at


@dataclass(frozen=True)
class Region:
    """One interval of one coordinate.

    Parameters
    ----------
    coordinate, unit : str
        What is cut into intervals.
    low, high : float
        The interval.
    direction : {"push", "pull", "both"}
        Half-cycles it is about; ``both`` signs the residual with the direction of motion, so that friction too high
        in push and pull alike shows as one number.
    """

    coordinate: str
    unit: str
    low: float
    high: float
    direction: str


@dataclass(frozen=True, eq=False)
class Regions:
    """All regions of a recording.

    Parameters
    ----------
    regions : tuple of Region
        In the order of the columns.
    columns : array, shape (n, n_regions)
        0 outside the region; inside +1 or, for ``both``, the direction of motion.
    """

    regions: tuple[Region, ...]
    columns: FloatArray


def regions_of(evidence: Evidence) -> Regions:
    """Cut position, speed, slip since reversal, travel, amplitude block and run into intervals.

    Parameters
    ----------
    evidence : Evidence
        The recordings.

    Returns
    -------
    Regions
    """
    position = evidence.stack("position_mm")
    speed = evidence.stack("speed_mm_s")
    slip = evidence.stack("slip_mm")
    travel = evidence.stack("travel_m")
    amplitude = evidence.stack("amplitude_mm")
    sense = evidence.stack("direction")
    half = evidence.histories[0].half_stroke_mm
    peak = evidence.histories[0].peak_speed_mm_s
    cuts = [
        (
            "position",
            "mm",
            position,
            np.array([-1.01, -0.9, -0.7, -0.5, -0.3, -0.1, 0.1, 0.3, 0.5, 0.7, 0.9, 1.01]) * half,
        ),
        ("speed", "mm/s", speed, np.array([0.0, 0.1, 0.25, 0.5, 0.75, 0.95, 1.5]) * peak),
        ("slip since reversal", "mm", slip, np.array([0.0, 0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.5, 2.01]) * half),
        ("travel", "m", travel, np.linspace(0.0, travel.max() * (1 + 1e-9), 13)),
        ("amplitude", "mm", amplitude, _levels(amplitude)),
        ("run", "1", evidence.run.astype(np.float64), np.arange(0.5, evidence.run.max() + 1)),
    ]
    regions, columns = [], []
    for coordinate, unit, values, edges in cuts:
        for low, high in pairwise(edges.tolist()):
            inside = (values >= low) & (values < high) & (evidence.weight > 0)
            for direction, column in _directed(inside, sense):
                if np.count_nonzero(column) >= MIN_SHARE * values.size:
                    regions.append(Region(coordinate, unit, float(low), float(high), direction))
                    columns.append(column)
    return Regions(tuple(regions), np.stack(columns, axis=1))


def _directed(inside: NDArray[np.bool_], sense: FloatArray) -> list[tuple[str, FloatArray]]:
    return [
        ("both", inside * sense),
        ("push", (inside & (sense > 0)).astype(np.float64)),
        ("pull", (inside & (sense < 0)).astype(np.float64)),
    ]


def _levels(values: FloatArray) -> FloatArray:
    """Edges between clearly different levels (blocks of one amplitude), at most a dozen."""
    ordered = np.sort(values)
    top = float(ordered[-1])
    jumps = np.flatnonzero(np.diff(ordered) > 0.06 * top)
    middles = (ordered[jumps] + ordered[jumps + 1]) / 2
    return np.concatenate([[0.0], middles[:11], [top * 1.001 + 1e-9]])
