"""The pictures of a device page as data URIs; the page says what they show."""

from typing import Any

import numpy as np

from shj_bayes.model.parameters import NOISE_PARAMETERS, FloatArray, base_and_run
from shj_bayes.model.priors import Prior
from shj_bayes.recording.columns import TENSION
from shj_bayes.report.figures import loops, posterior
from shj_bayes.report.force_unit import ForceUnit, force_unit
from shj_bayes.report.numbers import Band, DeviceFigures, pick_cycle
from shj_bayes.results.device import DeviceData, RunData


def draw(device: DeviceData, numbers: DeviceFigures) -> dict[str, Any]:
    """All pictures of a device page by place."""
    unit, b = force_unit(device.record), numbers.before
    runs = list(zip(device.runs, numbers.bands, strict=True))
    shapes = [shape for shape in numbers.shapes if shape.push_kN.size]
    energies = [e for e in numbers.energies if e.measured_J.size]
    draws, units = _shown(device, unit)
    noise = {name for name in draws if "." not in name and base_and_run(name)[0] in NOISE_PARAMETERS}
    return {
        "hero": loops.cycle([_one_cycle(run, band) for run, band in runs], unit),
        "time": [loops.over_time(run.time_s, run.force_kN, band.median, _noise(run), unit) for run, band in runs],
        "loops": [
            (loops.all_cycles(run.displacement_mm, run.force_kN, band, run.starts, unit), 100 * _inside(run, band))
            for run, band in runs
        ],
        "speed": loops.over_speed(
            [(f"run {r.number}", r.direction * r.speed_mm_s, r.force_kN, band.median) for r, band in runs], unit
        ),
        "residuals": [loops.over_stroke(profiles, unit) for profiles in numbers.profiles],
        "cycles": energies
        and {
            "envelope": loops.envelope(shapes, unit),
            "backbone": loops.backbone(shapes, unit),
            "energy": loops.energy(energies),
            "damping": loops.damping(shapes),
        },
        "channels": _channels(device),
        "densities": _densities(device, unit, draws, units),
        "corner": posterior.corner({name: v.ravel() for name, v in draws.items() if name not in noise}, units),
        "prior": loops.prior(b.displacement_mm, b.prior_kN, b.paper_kN, b.posterior_kN, unit),
        "traces": posterior.traces(draws, units),
    }


def _one_cycle(run: RunData, band: Band) -> tuple[str, FloatArray, FloatArray, Band]:
    at = pick_cycle(run)
    return f"run {run.number}", run.displacement_mm[at], run.force_kN[at], band.part(at)


def _inside(run: RunData, band: Band) -> float:
    """Share of the measured points in the band of the force."""
    return float(np.mean((run.force_kN >= band.force_low) & (run.force_kN <= band.force_high)))


def _noise(run: RunData) -> tuple[float, float]:
    """Band of the fitted noise, 90 %, kN."""
    noise = run.predicted_kN - run.law_kN
    low, high = np.quantile(noise[:: max(1, noise.shape[0] // 20)], (0.05, 0.95))
    return float(low), float(high)


def _channels(device: DeviceData) -> list[tuple[str, int, str, bool]]:
    """Further channels of each run, with their names; whether the force over the bolt tension is among them."""
    out = []
    for run, entry in zip(device.runs, device.record.inputs, strict=True):
        units = entry.extras
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
            out.append((loops.channels(run.time_s, shown), run.number, names, len(shown) > len(run.extras)))
    return out


def _shown(device: DeviceData, unit: ForceUnit) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Draws and units of the parameters as they are shown."""
    units = {row.name: unit.of(row.unit) for row in device.record.parameters}
    draws = {name: values * units[name][1] for name, values in device.draws.items()}
    return draws, {name: shown for name, (shown, _) in units.items()}


def _densities(device: DeviceData, unit: ForceUnit, draws: dict[str, FloatArray], units: dict[str, str]) -> str:
    parts = {}
    for row in device.record.prior_laws:
        law = Prior(**vars(row))
        factor = unit.of(law.unit)[1]
        values = draws[law.name].ravel()
        low, high = np.quantile(values, (0.001, 0.999))
        room = 0.5 * (high - low) or 1e-6 * abs(high) or 1e-6
        least, most = (factor * edge for edge in law.support)
        places = np.linspace(max(low - room, least + 1e-6 * room), min(high + room, most - 1e-6 * room), 160)
        parts[law.name] = (values, places, np.exp(law.log_density(places / factor)) / factor)
    return posterior.densities(parts, units)
