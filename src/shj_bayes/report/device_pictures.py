"""The pictures of a device page, each with its sentence. Importing this imports matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from shj_bayes.report import numbers as n
from shj_bayes.report import words
from shj_bayes.report.binned import residual
from shj_bayes.report.data import DeviceData, RunData
from shj_bayes.report.device_numbers import Numbers
from shj_bayes.report.figures import loops, posterior, residuals
from shj_bayes.report.page import Picture


def draw(device: DeviceData, numbers: Numbers) -> dict[str, Any]:
    """All pictures of a device page by place."""
    return {
        "hero": _hero(device, numbers),
        "loops": _loops(device, numbers),
        "residuals": _residuals(device, numbers),
        "corner": _corner(device),
        "energy": _energy(numbers),
        "degradation": _degradation(numbers),
        "prior": _prior(numbers),
        "chains": _chains(device),
    }


def _cycle_parts(device: DeviceData, numbers: Numbers, share: float) -> list[Any]:
    parts = []
    for run, band in zip(device.runs, numbers.bands, strict=True):
        at = n.pick_cycle(run, share)
        parts.append((f"run {run.number}", run.displacement_mm[at], run.force_kN[at], band.part(at)))
    return parts


def _hero(device: DeviceData, numbers: Numbers) -> Picture:
    runs = (
        "the first and the second run" if len(device.runs) == 2 else "each run" if len(device.runs) > 2 else "the run"
    )
    width = max(band.law_width_kN for band in numbers.bands)
    return Picture(
        loops.cycle(_cycle_parts(device, numbers, 1.0)),
        f"Force over displacement for one large cycle of {runs}: measured points, the model's line and a band around "
        "it.",
        f"One cycle of the largest stroke of {runs}. Points are measured; the coloured line is the model after the "
        f"fit, known to within about {words.short(width)} kN if the model is right. Nine in ten measured points "
        f"should lie in the pale band. {words.band_words(numbers.structure)}",
    )


def _loops(device: DeviceData, numbers: Numbers) -> list[Picture]:
    out = []
    for run, band in zip(device.runs, numbers.bands, strict=True):
        inside = np.mean((run.force_kN >= band.force_low) & (run.force_kN <= band.force_high))
        out.append(
            Picture(
                loops.all_cycles(run.displacement_mm, run.force_kN, band, run.starts),
                f"All loops of run {run.number}: force over displacement, measured, with the model and its 90 % band.",
                f"All cycles of run {run.number}. {100 * inside:.0f} % of the measured points lie in the band made "
                "for 90 %. Where the measured line shows beside the model's, the model does not follow the force.",
                f"All cycles, run {run.number}",
            )
        )
    small, alone = _cycle_parts(device, numbers, 0.0), len(device.runs) % 2 == 0
    if small[0][1].size < device.runs[0].time_s.size and _smaller(device.runs[0]):
        out.append(
            Picture(
                loops.cycle(small, wide=alone),
                "Force over displacement for one cycle of the smallest stroke, measured and modelled.",
                "The smallest cycles show the stiffness and how sharply sliding begins.",
                "One small cycle",
                wide=alone,
            )
        )
    return out


def _smaller(run: RunData) -> bool:
    """Whether the run has cycles of clearly different stroke."""
    small, large = (run.displacement_mm[n.pick_cycle(run, share)] for share in (0.0, 1.0))
    return float(np.ptp(small)) < 0.8 * float(np.ptp(large))


def _residuals(device: DeviceData, numbers: Numbers) -> list[Picture]:
    out = []
    for run, profiles in zip(device.runs, numbers.profiles, strict=True):
        left = residual(run)
        noise = run.predicted_kN - run.law_kN
        low, high = (float(v) for v in np.quantile(noise[:: max(1, noise.shape[0] // 20)], (0.05, 0.95)))
        out += [
            Picture(
                residuals.over_stroke(profiles),
                f"Mean of measured minus model force over displacement in run {run.number}, for both directions, "
                "with the band that noise alone would give.",
                "Averaged over all cycles, noise should leave the points inside their pale bands. A shape outside "
                "the bands is force that the model does not have.",
                f"Left over along the stroke, run {run.number}",
            ),
            Picture(
                residuals.over_displacement(run.displacement_mm, left, run.direction),
                f"Measured minus model force of every sample over displacement in run {run.number}, coloured by "
                "direction.",
                "Every sample. Noise is a level cloud of even height in which the two colours mix.",
                f"Left over, every sample, run {run.number}",
            ),
            Picture(
                residuals.over_time(run.time_s, left, (low, high)),
                f"Measured minus model force over time in run {run.number}, with the band of the fitted noise.",
                "Noise fills the band evenly from start to end. Waves in step with the cycles, or a drift, are not "
                "noise.",
                f"Left over along time, run {run.number}",
                wide=True,
            ),
        ]
    return out


def _corner(device: DeviceData) -> Picture:
    units = {row["name"]: row["unit"] for row in device.record["parameters"]}
    return Picture(
        posterior.corner({name: draws.ravel() for name, draws in device.draws.items()}, units),
        "Corner plot: how likely the values of each parameter are, and of each pair together.",
        "On the diagonal, how likely each value is; below it, each pair together (lines hold 50 and 90 %). A slanted "
        "ellipse means that the test fixes a combination of the two better than either alone. Under gamma stands "
        "dep = 1/gamma in brackets.",
        wide=True,
    )


def _energy(numbers: Numbers) -> list[Picture]:
    shown = [e for e in numbers.energies if e.measured_J.size]
    if not shown:
        return []
    return [
        Picture(
            loops.energy(shown),
            "Energy dissipated in each cycle, measured and predicted with a 90 % band.",
            "Circles are measured, dashes predicted. The energy of a cycle is the area of its loop.",
            "Energy of each cycle",
            wide=True,
        ),
        Picture(
            loops.energy_error(shown),
            "Predicted minus measured energy of each cycle in per cent.",
            "The same as a difference. A trend over the cycles means that the device changed while it was tested, "
            "which the model does not know.",
            "How far the prediction is off",
            wide=True,
        ),
    ]


def _degradation(numbers: Numbers) -> list[Picture]:
    if not numbers.losses:
        return []
    return [
        Picture(
            loops.degradation(numbers.losses),
            "How likely each loss of sliding force from the first to a later run is.",
            "The full line is the middle, the broken lines hold 90 %.",
        )
    ]


def _prior(numbers: Numbers) -> Picture:
    b = numbers.before
    return Picture(
        loops.prior(b.displacement_mm, b.prior_kN, b.paper_kN, b.posterior_kN),
        "Loops that were held possible before the test in grey, loops of published devices in green where they "
        "apply, and the loops of this device after the test in blue.",
        "Grey is what the priors allowed. Blue is what the test left of it: narrow where the test says much.",
        wide=True,
    )


def _chains(device: DeviceData) -> list[Picture]:
    units = {row["name"]: row["unit"] for row in device.record["parameters"]}
    walkers = int(device.record["sampling"]["n_walkers"])
    effective = {row["name"]: float(row["ess_bulk"] or 1.0) for row in device.record["parameters"]}
    return [
        Picture(
            posterior.traces({name: n.steps_of(d, walkers) for name, d in device.draws.items()}, units),
            "Path of each independent search for every parameter.",
            "Each colour is one independent search. All should wander over the same range, without a trend.",
            "Traces",
        ),
        Picture(
            posterior.ranks({name: n.rank_shares(d, effective[name]) for name, d in device.draws.items()}),
            "For each search, how its values rank among those of all searches.",
            "If the searches agree, every line stays near 1, inside the grey band.",
            "Ranks",
        ),
    ]
