"""The pictures of a device page, each with its sentence. Importing this imports matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

from shj_bayes.model.parameters import NOISE_PARAMETERS, FloatArray, base_and_run
from shj_bayes.model.priors import Prior
from shj_bayes.recording.columns import TENSION
from shj_bayes.report import numbers as n
from shj_bayes.report import words
from shj_bayes.report.data import DeviceData
from shj_bayes.report.device_numbers import Numbers
from shj_bayes.report.figures import loops, posterior, residuals
from shj_bayes.report.force_unit import ForceUnit, force_unit
from shj_bayes.report.page import Picture
from shj_bayes.report.residual_file import LeftOver


def draw(device: DeviceData, numbers: Numbers, left: LeftOver) -> dict[str, Any]:
    """All pictures of a device page by place."""
    unit = force_unit(device.record)
    return {
        "hero": _hero(device, numbers, left, unit),
        "time": _over_time(device, numbers, unit),
        "loops": _loops(device, numbers, unit),
        "speed": _over_speed(device, numbers, unit),
        "residuals": _residuals(numbers, unit),
        "cycles": _cycles(numbers, unit),
        "channels": _channels(device),
        "densities": _densities(device, unit),
        "corner": _corner(device, unit),
        "prior": _prior(numbers, unit),
        "traces": _traces(device, unit),
    }


def _cycle_parts(device: DeviceData, numbers: Numbers) -> list[Any]:
    parts = []
    for run, band in zip(device.runs, numbers.bands, strict=True):
        at = n.pick_cycle(run)
        parts.append((f"run {run.number}", run.displacement_mm[at], run.force_kN[at], band.part(at)))
    return parts


def _hero(device: DeviceData, numbers: Numbers, left: LeftOver, unit: ForceUnit) -> Picture:
    runs = (
        "the first and the second run" if len(device.runs) == 2 else "each run" if len(device.runs) > 2 else "the run"
    )
    width = unit.factor * max(band.law_width_kN for band in numbers.bands)
    return Picture(
        loops.cycle(_cycle_parts(device, numbers), unit),
        f"Force over displacement for one large cycle of {runs}: measured points, the model's line and a band around "
        "it.",
        f"One cycle of the largest stroke of {runs}: points measured, line the model, known to about "
        f"{words.short(width)} {unit.name} if it is right; 90 % of the points should lie in the band. "
        f"{words.band_words(left)}",
    )


def _over_time(device: DeviceData, numbers: Numbers, unit: ForceUnit) -> list[Picture]:
    out = []
    for run, band in zip(device.runs, numbers.bands, strict=True):
        noise = run.predicted_kN - run.law_kN
        low, high = (float(v) for v in np.quantile(noise[:: max(1, noise.shape[0] // 20)], (0.05, 0.95)))
        out.append(
            Picture(
                loops.over_time(run.time_s, run.force_kN, band.median, (low, high), unit),
                f"Force over time in run {run.number}, measured and modelled, and below it the residual, measured "
                "minus model, with the band of the fitted noise.",
                "Noise fills the band evenly from start to end. Waves in step with the cycles, or a drift, are not "
                "noise.",
                f"Force over time, run {run.number}",
                wide=True,
            )
        )
    return out


def _loops(device: DeviceData, numbers: Numbers, unit: ForceUnit) -> list[Picture]:
    out = []
    for run, band in zip(device.runs, numbers.bands, strict=True):
        inside = np.mean((run.force_kN >= band.force_low) & (run.force_kN <= band.force_high))
        out.append(
            Picture(
                loops.all_cycles(run.displacement_mm, run.force_kN, band, run.starts, unit),
                f"All loops of run {run.number}: force over displacement, measured, with the model and its 90 % band.",
                f"All cycles of run {run.number}. {100 * inside:.0f} % of the measured points lie in the band made "
                "for 90 %. Where the measured line shows beside the model's, the model does not follow the force.",
                f"All cycles, run {run.number}",
            )
        )
    return out


def _residuals(numbers: Numbers, unit: ForceUnit) -> list[Picture]:
    return [
        Picture(
            residuals.over_stroke(profiles, unit),
            f"Mean residual over displacement in run {profiles[0].run}, for both loading directions, with the band "
            "that noise alone would give.",
            "Averaged over all cycles, noise should leave the points inside their pale bands. A shape outside "
            "the bands is force that the model does not have.",
            f"Residuals along the stroke, run {profiles[0].run}",
        )
        for profiles in numbers.profiles
    ]


def _over_speed(device: DeviceData, numbers: Numbers, unit: ForceUnit) -> Picture:
    parts = [
        (f"run {run.number}", run.direction * run.speed_mm_s, run.force_kN, band.median)
        for run, band in zip(device.runs, numbers.bands, strict=True)
    ]
    return Picture(
        loops.over_speed(parts, unit),
        "Force over velocity, measured and modelled, every sample.",
        "A level plateau does not depend on speed; the curves from one plateau to the other are the reversals.",
        "Force over velocity",
    )


def _cycles(numbers: Numbers, unit: ForceUnit) -> list[Picture]:
    shown = [e for e in numbers.energies if e.measured_J.size]
    if not shown:
        return []
    shapes = [shape for shape in numbers.shapes if shape.push_kN.size]
    return [
        Picture(
            loops.envelope(shapes, unit),
            "Largest force and plateau of every cycle, push and pull.",
            "Open marks are the largest force of the cycle, filled ones the plateau: the median over the middle half "
            "of the stroke. Pull is drawn upwards, so that a gap between the two directions is asymmetry.",
            "Envelope and plateau",
        ),
        Picture(
            loops.backbone(shapes, unit),
            "Backbone: force at the largest displacement of every cycle, push and pull, measured and modelled.",
            "The force where each cycle turns, over the displacement there: dots are measured, the line is the model.",
            "Backbone",
        ),
        Picture(
            loops.energy(shown),
            "Energy dissipated in each cycle, measured and predicted with a 90 % band.",
            "Circles are measured, dashes predicted. The energy of a cycle is the area of its loop.",
            "Energy",
        ),
        Picture(
            loops.damping(shapes),
            "Equivalent viscous damping of each cycle, measured and modelled.",
            "Energy over that of an elastic cycle of the same largest force and displacement, times 4 pi; a rectangle "
            "has 64 %.",
            "Equivalent damping",
        ),
    ]


def _channels(device: DeviceData) -> list[Picture]:
    """Further channels of each run, and the force over the bolt tension where one is given."""
    out = []
    for run, entry in zip(device.runs, device.record["inputs"], strict=True):
        units = entry.get("extras", {})
        shown = [
            (f"{name} ({units[name]})" if units.get(name) else name, values)
            for name, values in run.extras.items()
            if np.isfinite(values).any()
        ]
        tension = run.extras.get(TENSION)
        if tension is not None and units.get(TENSION) == "kN":
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.abs(run.force_kN) / tension
            shown.append(("mu = F/N", np.where(tension > 0, ratio, np.nan)))
        if shown:
            names = ", ".join(title for title, _ in shown)
            out.append(
                Picture(
                    loops.channels(run.time_s, shown),
                    f"Further channels of run {run.number} over time: {names}.",
                    "As recorded; the model does not use them."
                    + (" mu is the absolute force over the tension named." if len(shown) > len(run.extras) else ""),
                    f"Further channels, run {run.number}",
                    wide=True,
                )
            )
    return out


def _shown(device: DeviceData, unit: ForceUnit) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Draws and units of the parameters as they are shown."""
    units = {row["name"]: unit.of(row["unit"]) for row in device.record["parameters"]}
    draws = {name: values * units[name][1] for name, values in device.draws.items()}
    return draws, {name: shown for name, (shown, _) in units.items()}


def _densities(device: DeviceData, unit: ForceUnit) -> Picture:
    draws, units = _shown(device, unit)
    parts = {}
    for row in device.record["prior_laws"]:
        factor = unit.of(row["unit"])[1]
        law = Prior(row["name"], row["unit"], row["law"], row["a"], row["b"], row["source"])
        values = draws[row["name"]].ravel()
        low, high = np.quantile(values, (0.001, 0.999))
        room = 0.5 * (high - low) or 1e-6 * abs(high) or 1e-6
        least, most = (factor * edge for edge in law.support)
        places = np.linspace(max(low - room, least + 1e-6 * room), min(high + room, most - 1e-6 * room), 160)
        parts[row["name"]] = (values, places, np.exp(law.log_density(places / factor)) / factor)
    return Picture(
        posterior.densities(parts, units),
        "Posterior of each parameter as a histogram, with the density of its prior as a broken line.",
        "Blue is the posterior, broken the prior. Where the two look alike the recording says little; where blue lies "
        "in the tail of the broken line, prior and data contradict each other.",
        "Prior and posterior",
        wide=True,
    )


def _corner(device: DeviceData, unit: ForceUnit) -> Picture:
    draws, units = _shown(device, unit)
    physical = {n: v.ravel() for n, v in draws.items() if "." in n or base_and_run(n)[0] not in NOISE_PARAMETERS}
    return Picture(
        posterior.corner(physical, units),
        "Corner plot of the device's parameters: how likely the values of each are, and of each pair together.",
        "On the diagonal, how likely each value is; below it, each pair together (lines hold 50 and 90 %). A slanted "
        "ellipse means that the test fixes a combination of the two better than either alone. Under gamma stands "
        "dep = 1/gamma in brackets. The parameters of the noise stand under Prior and posterior.",
        wide=True,
    )


def _prior(numbers: Numbers, unit: ForceUnit) -> Picture:
    b = numbers.before
    return Picture(
        loops.prior(b.displacement_mm, b.prior_kN, b.paper_kN, b.posterior_kN, unit),
        "Prior predictive check: loops that were held possible before the test in grey, loops of published devices in "
        "green where they apply, and the loops of this device after the test in blue.",
        "Grey is what the priors allowed. Blue is what the test left of it: narrow where the test says much.",
        wide=True,
    )


def _traces(device: DeviceData, unit: ForceUnit) -> Picture:
    return Picture(
        posterior.traces(*_shown(device, unit)),
        "Trace of every parameter: where the walkers of each independent ensemble were, step by step.",
        "Each colour is one independent ensemble, each dot a walker. All colours should cover the same range from left "
        "to right, without a trend.",
        wide=True,
    )
