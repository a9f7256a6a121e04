"""First cycle over third cycle of the same amplitude, read off the recordings of a campaign: no model is needed.

The law holds the sliding force from cycle to cycle of a run, so what a first cycle does is measured here: force at
mid-stroke of the first and second half-cycle of a block of equal amplitude over that of the half-cycle in the same
direction two cycles later, at the same position and speed, in the first block of each run that slides fully (one that
does not says nothing of a sliding force).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.inference.store import read_group
from shj_bayes.margins.pair import NONE, Bounds
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.population.quantities import FloatArray

LATER = 4
"""Half-cycles from the first cycle to the third, in the same direction."""
EQUAL = 0.05
"""Share by which the amplitudes of one block may differ."""
MOST_DEVICES = 5
"""Devices of a set that are read: a twentieth of a second each."""
SLIDING = 0.6
"""Least force at mid-stroke, as a share of the largest of the run, of a block that slides fully."""


def first_over_third(folder: Path) -> Bounds | None:
    """Smallest and largest first cycle over third of a device's recordings.

    Parameters
    ----------
    folder : Path
        Results folder of the device's fit.

    Returns
    -------
    Bounds or None
        Over the runs; None where no block has three cycles that slide, or the files do not say.
    """
    try:
        data = read_group(folder, "constant_data")
        force = read_group(folder, "observed_data")["force"]
        channels = (data["displacement_mm"], force, data["half_cycle_of_sample"], data["run"])
    except (ShjError, KeyError):
        return None
    found = list(ratios(*channels))
    return Bounds.around(*found) if found else None


def ratios(
    displacement_mm: FloatArray, force_kN: FloatArray, half_cycle: FloatArray, run: FloatArray
) -> Iterator[float]:
    """First over third cycle, run by run, in the first block of three cycles that slides fully.

    Parameters
    ----------
    displacement_mm, force_kN : array, shape (n,)
        Channels, runs one after the other.
    half_cycle, run : array, shape (n,)
        Number of the half-cycle within its run, and of the run.
    """
    for r in np.unique(run):
        of_run = run == r
        amplitude, plateau = _half_cycles(displacement_mm[of_run], force_kN[of_run], half_cycle[of_run])
        if not plateau.size:
            continue
        start = 0
        for end in range(1, amplitude.size + 1):
            if end < amplitude.size and abs(amplitude[end] / amplitude[start] - 1.0) < EQUAL:
                continue
            first, third = plateau[start : start + 2], plateau[start + LATER : min(start + LATER + 2, end)]
            if third.size and third.min() > SLIDING * plateau.max():
                yield float(np.mean(first[: third.size] / third))
                break
            start = end


def _half_cycles(x: FloatArray, force: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Amplitude of the complete half-cycles, and the median of the force within a quarter of it around mid-stroke."""
    amplitude, plateau = [], []
    for h in np.unique(half)[1:-1]:
        of_it = half == h
        low, high = float(x[of_it].min()), float(x[of_it].max())
        near = np.abs(x[of_it] - 0.5 * (low + high)) < 0.125 * (high - low)
        if near.any():
            amplitude.append(0.5 * (high - low))
            plateau.append(float(np.median(np.abs(force[of_it][near]))))
    return np.array(amplitude), np.array(plateau)


def by_set(devices: Iterable[tuple[str, Path]]) -> dict[str, Bounds]:
    """Outermost of the devices of each set (the first ``MOST_DEVICES``), and of all for a set never tested.

    Parameters
    ----------
    devices : iterable of (set, folder)
        Devices with the folders of their fits.

    Returns
    -------
    dict of str to Bounds
        Sets of which at least one device says something.
    """
    out: dict[str, Bounds] = {}
    read: Counter[str] = Counter()
    for set_name, folder in devices:
        read[set_name] += 1
        found = first_over_third(folder) if read[set_name] <= MOST_DEVICES else None
        if found is None:
            continue
        for name in (set_name, ANY_SET):
            known = out.get(name, NONE)
            out[name] = Bounds.around(known.low, known.high, found.low, found.high)
    return out
