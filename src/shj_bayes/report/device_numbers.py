"""All numbers that a device page draws or says, computed once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.report import numbers as n
from shj_bayes.report.beforehand import Beforehand, beforehand
from shj_bayes.report.binned import StrokeProfile, stroke_profiles
from shj_bayes.report.data import DeviceData


@dataclass(frozen=True, eq=False)
class Numbers:
    """All that is drawn or said, computed once."""

    bands: tuple[n.Band, ...]
    energies: tuple[n.CycleEnergy, ...]
    shapes: tuple[n.CycleShape, ...]
    losses: tuple[n.Degradation, ...]
    profiles: tuple[tuple[StrokeProfile, StrokeProfile], ...]
    one_speed: float | None
    before: Beforehand


def numbers_of(device: DeviceData) -> Numbers:
    """Compute the numbers of a device page."""
    energies = tuple(n.cycle_energy(run) for run in device.runs)
    first = device.runs[0]
    whole = 0.5 * float(np.ptp(first.displacement_mm))
    amplitude = max((float(e.amplitude_mm.max()) for e in energies if e.amplitude_mm.size), default=whole)
    speed = max((float(np.median(e.peak_speed_mm_s)) for e in energies if e.peak_speed_mm_s.size), default=0.0)
    speed = speed or float(np.quantile(first.speed_mm_s, 0.98))
    bands = tuple(n.force_band(run) for run in device.runs)
    measured = zip(device.runs, energies, bands, strict=True)
    return Numbers(
        bands,
        energies,
        tuple(n.cycle_shape(run, energy, band.median) for run, energy, band in measured),
        n.degradation(device),
        tuple(stroke_profiles(run) for run in device.runs),
        n.one_peak_speed(energies),
        beforehand(device, amplitude, speed),
    )
