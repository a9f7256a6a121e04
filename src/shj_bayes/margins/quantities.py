"""Design quantities: what a designer takes from the force of a test, for the first and the following runs."""

from collections.abc import Iterator, Sequence

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.row import HIGH, LOW
from shj_bayes.margins.virtual_test import FLAT, UNEVEN, Readings
from shj_bayes.model.parameters import FloatArray, run_name
from shj_bayes.population.quantities import DESIGN, HIGHEST, LEAST, LOWEST, MOST

ALIKE = 0.01
"""Share by which amplitudes of one block may differ."""
THIRD = 2
SIDE = {LEAST: LOW, LOWEST: LOW, MOST: HIGH, HIGHEST: HIGH}
"""Side on which a quantity, of any run, must not be wrong; all others are typical values."""
TABLE = {
    "least": ("kN", "smallest plateau force (mean over the middle half of the stroke)"),
    "least_cycle": ("1", "half-cycle in which it comes, counted over those that slide fully"),
    "most": ("kN", "largest force anywhere in the run"),
    "plateau": ("kN", "mean plateau force"),
    "first": ("kN", "plateau force of the first cycle"),
    "third": ("kN", "plateau force of the third cycle"),
    "last": ("kN", "plateau force of the last cycle"),
    "push": ("kN", "mean plateau force while displacement grows"),
    "pull": ("kN", "mean plateau force while displacement falls"),
    "end": ("kN", "force at the end of the largest stroke"),
    "energy": ("kJ", "energy of a cycle of the largest amplitude"),
    "stiffness": ("kN/mm", "effective stiffness of that cycle, end force over amplitude"),
    "damping": ("1", "effective damping of that cycle, (2/pi) E / (k_eff (2A)^2)"),
    "loss_per_m": ("1/m", "share of the plateau force lost per metre of sliding, over the run"),
}
"""All that is read of a run: unit and meaning."""


def counted_from(readings: Sequence[Readings]) -> float:
    """Smallest amplitude from which on every half-cycle slides fully; infinity where none does, mm."""
    amplitude = np.concatenate([r.amplitude_mm[r.complete] for r in readings])
    for flat in (FLAT, UNEVEN):
        slides = np.concatenate([r.sliding(flat)[r.complete] for r in readings])
        stuck = amplitude[~slides].max(initial=0.0)
        able = amplitude[slides & (amplitude > stuck * (1.0 + ALIKE))]
        if able.size:
            return float(able.min())
    return np.inf


def of_readings(readings: Readings, least_amplitude_mm: float) -> dict[str, FloatArray]:
    """Design quantities of one run, each of shape (m,), with names and units as in ``TABLE``.

    Half-cycles count from an amplitude on; `PopulationError` if none of them slides fully.
    """
    large = readings.amplitude_mm >= least_amplitude_mm * (1.0 - ALIKE)
    counted = np.flatnonzero(readings.complete & large)
    if not counted.size:
        raise PopulationError(
            "no half-cycle of this history slides fully, so no sliding force can be read off it; give one with larger "
            "strokes"
        )
    plateau = readings.plateau_kN[:, counted]
    direction, travel = readings.direction[counted], readings.travel_m[counted]
    cycles = np.stack([plateau[:, i : i + 2].mean(axis=1) for i in range(0, counted.size, 2)], axis=1)
    amplitude = readings.amplitude_mm[counted]
    widest = counted[amplitude >= amplitude.max() * (1.0 - ALIKE)]
    end, stroke = readings.end_kN[:, widest].mean(axis=1), 2.0 * float(readings.amplitude_mm[widest].mean())
    energy = 2.0 * readings.work_kJ[:, widest].mean(axis=1)
    stiffness = 2.0 * end / stroke
    log, apart = np.log(np.maximum(plateau, 1e-9)), travel - travel.mean()
    squares = float(apart @ apart)
    with np.errstate(divide="ignore", invalid="ignore"):
        damping = (2.0 / np.pi) * 1000.0 * energy / (stiffness * stroke**2)
    return {
        "least": plateau.min(axis=1),
        "least_cycle": plateau.argmin(axis=1) + 1.0,
        "most": np.nanmax(readings.largest_kN, axis=1),
        "plateau": plateau.mean(axis=1),
        "first": cycles[:, 0],
        "third": cycles[:, min(THIRD, cycles.shape[1] - 1)],
        "last": cycles[:, -1],
        "push": _mean(plateau[:, direction > 0]),
        "pull": _mean(plateau[:, direction < 0]),
        "end": end,
        "energy": energy,
        "stiffness": stiffness,
        "damping": damping,
        "loss_per_m": -(log @ apart) / squares if squares > 0 else np.zeros(plateau.shape[0]),
    }


def _mean(values: FloatArray) -> FloatArray:
    return values.mean(axis=1) if values.shape[1] else np.full(values.shape[0], np.nan)


def pooled(runs: Sequence[dict[str, FloatArray]]) -> Iterator[tuple[str, FloatArray]]:
    """Quantities of all runs that go into the population: name and draws, shape (m,)."""
    yield LOWEST, np.min([run[LEAST] for run in runs], axis=0)
    yield HIGHEST, np.max([run[MOST] for run in runs], axis=0)
    for number, values in enumerate(runs, start=1):
        for base in TABLE:
            name = base if number == 1 else f"{base}_{number}"
            if name in DESIGN:
                yield name, values[base]
        if number > 1:
            yield run_name("ratio", number), values["plateau"] / runs[0]["plateau"]
