"""What is read off the force of a run, half-cycle by half-cycle: plateaus, largest forces, energies of cycles.

The same reading serves a predicted force and a measured one, so that the two can be held against each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.errors import PopulationError
from shj_bayes.model.parameters import run_name
from shj_bayes.population.quantities import DESIGN, HIGHEST, LEAST, LOWEST, MOST
from shj_bayes.recording.motion import Motion

MIDDLE = 0.25
"""Share of the stroke on either side of mid-stroke over which the plateau force of a half-cycle is the mean."""
FLAT, UNEVEN = 0.9, 0.6
"""Least force at the beginning of that part, as a share of its mean, of a half-cycle that slides fully: of a device
whose force is much alike along the stroke, and of one whose force never is."""
TAKEN = 5
REACH_MM = 0.5
"""Samples over which a measured force is averaged before its largest value is read, as far as the device moves no
farther than this meanwhile: a breakaway peak fades over a millimetre, and five samples of 10 Hz took 5 % off it."""


READ = ("plateau_kN", "onset_kN", "largest_kN", "end_kN", "work_kJ")


@dataclass(frozen=True, eq=False)
class Readings:
    """What is read off the force of one run, half-cycle by half-cycle, for one or many devices."""

    amplitude_mm: FloatArray  # shape (n_half,): half of the stroke
    direction: FloatArray  # shape (n_half,): +1 in push (displacement grows), -1 in pull
    travel_m: FloatArray  # shape (n_half,): cumulative sliding distance in the middle of the half-cycle
    complete: BoolArray  # shape (n_half,): whether it runs from one reversal to the next
    peak_mm_s: FloatArray  # shape (n_half,): peak speed
    # shape (m, n_half): mean force over the middle half of the stroke, in the direction of motion
    plateau_kN: FloatArray
    # shape (m, n_half): force where that part begins: well below the plateau where the device does not slide yet
    onset_kN: FloatArray
    largest_kN: FloatArray  # shape (m, n_half): largest force in the direction of motion
    end_kN: FloatArray  # shape (m, n_half): force at the end of the stroke
    work_kJ: FloatArray  # shape (m, n_half): work done on the device

    def sliding(self, flat: float = FLAT) -> BoolArray:
        """Complete half-cycles in which the typical device slides before the middle part of the stroke, (n_half,)."""
        onset, plateau = np.median(self.onset_kN, axis=0), np.median(self.plateau_kN, axis=0)
        return np.asarray(self.complete & (plateau > 0) & (onset >= flat * plateau))


def read_off(force_kN: FloatArray, motion: Motion, travel_m: FloatArray, *, measured: bool = False) -> Readings:
    """Read the force of one or many devices, shape (m, n_samples), half-cycle by half-cycle.

    A `measured` force carries noise: it is averaged over up to `TAKEN` samples, and `REACH_MM` of motion, before its
    largest value is taken.
    """
    x, start = motion.displacement_mm, motion.start
    n = motion.n_half
    out = {name: np.full((force_kN.shape[0], n), np.nan) for name in READ}
    amplitude, travel = np.zeros(n), np.zeros(n)
    moved = np.abs(np.gradient(x)) + 1e-12
    for h in range(n):
        part, sign = slice(start[h], start[h + 1]), float(motion.direction[h])
        own, force = x[part], sign * force_kN[:, part]
        begin, end = motion.turning_mm[h], motion.turning_mm[h + 1] if h + 1 < n else own[-1]
        stroke = abs(end - begin)
        amplitude[h], travel[h] = 0.5 * stroke, float(np.mean(travel_m[part]))
        weight = np.where(np.abs(own - 0.5 * (begin + end)) <= MIDDLE * stroke, moved[part], 0.0)
        if not weight.any():
            weight = moved[part].copy()
        first = weight * (np.cumsum(weight) <= 0.2 * weight.sum())
        out["plateau_kN"][:, h] = force @ weight / weight.sum()
        out["onset_kN"][:, h] = force @ first / first.sum() if first.any() else out["plateau_kN"][:, h]
        last = np.where(np.abs(end - own) <= 0.02 * stroke, 1.0, 0.0) if measured else np.zeros(own.size)
        last[-1] = 1.0
        out["end_kN"][:, h] = force @ last / last.sum()
        taken = min(TAKEN, own.size, 1 + int(REACH_MM / moved[part].max())) if measured else 1
        if taken > 1:
            force = np.stack([np.convolve(row, np.full(taken, 1.0 / taken), "valid") for row in force])
        out["largest_kN"][:, h] = force.max(axis=1)
        joined = slice(start[h], min(start[h + 1] + 1, x.size))
        out["work_kJ"][:, h] = trapezoid(force_kN[:, joined], x[joined], axis=1) / 1000.0
    complete = (np.arange(n) > 0) & (np.arange(n) < n - 1)
    return Readings(amplitude, motion.direction.astype(np.float64), travel, complete, motion.peak_mm_s, *out.values())


ALIKE = 0.01
"""Share by which amplitudes of one block may differ."""
THIRD = 2
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
    found = (sliding_from(readings, flat) for flat in (FLAT, UNEVEN))
    return next((least for least in found if np.isfinite(least)), np.inf)


def sliding_from(readings: Sequence[Readings], flat: float) -> float:
    """Smallest amplitude from which on every half-cycle counts as sliding by `flat`; infinity where none does, mm."""
    amplitude = np.concatenate([r.amplitude_mm[r.complete] for r in readings])
    slides = np.concatenate([r.sliding(flat)[r.complete] for r in readings])
    stuck = amplitude[~slides].max(initial=0.0)
    return float(amplitude[slides & (amplitude > stuck * (1.0 + ALIKE))].min(initial=np.inf))


def of_readings(readings: Readings, least_amplitude_mm: float) -> dict[str, FloatArray]:
    """Design quantities of one run, each of shape (m,), with names and units as in ``TABLE``.

    Half-cycles count from an amplitude on; `PopulationError` if none of them slides fully.
    """
    counted = half_cycles_from(readings, least_amplitude_mm)
    if not counted.size:
        raise PopulationError("no half-cycle slides fully, so no sliding force can be read off")
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
    push, pull = (
        plateau[:, way].mean(axis=1) if way.any() else np.full(plateau.shape[0], np.nan)
        for way in (direction > 0, direction < 0)
    )
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
        "push": push,
        "pull": pull,
        "end": end,
        "energy": energy,
        "stiffness": stiffness,
        "damping": damping,
        "loss_per_m": -(log @ apart) / squares if squares > 0 else np.zeros(plateau.shape[0]),
    }


def half_cycles_from(readings: Readings, least_amplitude_mm: float) -> IntArray:
    """Half-cycles that count, from an amplitude on."""
    large = readings.amplitude_mm >= least_amplitude_mm * (1.0 - ALIKE)
    return np.flatnonzero(readings.complete & large)


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
