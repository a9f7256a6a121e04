"""The band of the loop itself: where the force of a new device lies over one steady cycle."""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import trapezoid

from shj_bayes.errors import PopulationError
from shj_bayes.model.law import BETA_RANGE, force_of_laws
from shj_bayes.population.predict import SECOND_RUN, NewDevice
from shj_bayes.population.quantities import LEVELS, FloatArray, band_of
from shj_bayes.recording.protocol import Block, exact_motion

N_DRAWS, N_POINTS = 500, 121
"""Devices drawn at most; displacements at which a band is given."""
_SAMPLES_PER_CYCLE = 400
_PUSH, _PULL = 2, 3  # half-cycles of a two-cycle sine that make up its steady loop


@dataclass(frozen=True)
class LoopBand:
    """5, 50 and 95 % of the force over a steady cycle, point by point.

    The band holds 90 % of devices at every displacement taken by itself, not whole loops.
    """

    set_name: str  # set of the new device
    run: int  # 1, 2: first run, or second with the sliding force lowered by the ratio
    amplitude_mm: float
    peak_speed_mm_s: float
    displacement_mm: FloatArray = field(repr=False)  # shape (n,): from -amplitude to +amplitude
    # push, pull: shape (3, n): force, kN, at 5, 50 and 95 %; push while displacement grows, pull while it falls
    push: FloatArray = field(repr=False)
    pull: FloatArray = field(repr=False)
    energy_kN_mm: tuple[float, float, float]  # energy of one cycle at 5, 50 and 95 %, kN mm (equal to joule)
    n_devices: int  # tested devices of the set


def loop_band(device: NewDevice, *, amplitude_mm: float, peak_speed_mm_s: float = 10.0, run: int = 1) -> LoopBand:
    """Band of the force of a new device by the published law over the second cycle of a sine, in run 1 or 2.

    Beta is kept inside what the law allows. Keep the amplitude inside what was tested; a peak speed of 10 mm/s is what
    the paper tested, beyond it the law extrapolates. `PopulationError` if a quantity is missing or the motion is not
    possible.
    """
    if not (np.isfinite([amplitude_mm, peak_speed_mm_s]).all() and amplitude_mm > 0 and peak_speed_mm_s > 0):
        raise PopulationError(
            f"amplitude and peak speed must be above zero; got {amplitude_mm:g} mm and {peak_speed_mm_s:g} mm/s"
        )
    if run not in (1, 2):
        raise PopulationError(f"a loop is of run 1 or 2, not {run}")
    force_name = "Fy" if run == 1 else SECOND_RUN
    missing = [q for q in ("K", force_name, "beta", "gamma") if q not in device.draws]
    if missing:
        raise PopulationError(
            f"the loop of {device.set_name!r} in run {run} needs {', '.join(missing)}, which no device gives; "
            "add devices that do" + (" (two runs each)" if run == 2 else "")
        )
    total = device.draws["K"].size
    chosen = np.linspace(0, total - 1, min(N_DRAWS, total)).astype(np.int64)
    laws = np.column_stack([device.draws[q][chosen] for q in ("K", force_name, "beta", "gamma")])
    laws[:, 2] = np.clip(laws[:, 2], *BETA_RANGE)
    frequency = peak_speed_mm_s / (2.0 * np.pi * amplitude_mm)
    _, motion = exact_motion((Block(amplitude_mm, frequency, 2),), _SAMPLES_PER_CYCLE * frequency)
    force = force_of_laws(motion, laws)
    x, start = motion.displacement_mm, motion.start
    grid = np.linspace(-amplitude_mm, amplitude_mm, N_POINTS)
    up, down = slice(start[_PUSH], start[_PUSH + 1]), slice(start[_PULL], start[_PULL + 1])
    push = np.array([np.interp(grid, x[up], f[up]) for f in force])
    pull = np.array([np.interp(grid, x[down][::-1], f[down][::-1]) for f in force])
    cycle = slice(start[_PUSH], start[_PULL + 1] + 1)
    energy = trapezoid(force[:, cycle], x[cycle], axis=1)
    bands = (np.quantile(push, LEVELS, axis=0), np.quantile(pull, LEVELS, axis=0), band_of(energy))
    head = (device.set_name, run, amplitude_mm, peak_speed_mm_s, grid)
    return LoopBand(*head, *bands, device.n_devices)
