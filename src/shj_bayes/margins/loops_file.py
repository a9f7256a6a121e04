"""Bands of the widest cycle of the tested devices, run by run, as values and as a CSV file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import trapezoid

from shj_bayes._util.files import write_text
from shj_bayes.margins.trial import Trial
from shj_bayes.population.loops import N_POINTS, LoopBand
from shj_bayes.population.quantities import LEVELS, FloatArray, band_of
from shj_bayes.population.results import safe_cell

LOOPS_CSV = "loops.csv"


def loops(trials: Sequence[Trial], peak_speed_mm_s: float) -> tuple[LoopBand, ...]:
    """Draw the loop bands of every set, run by run; its widest cycle is cut to what all its devices went through."""
    out = []
    for name in dict.fromkeys(trial.set_name for trial in trials):
        own = [trial for trial in trials if trial.set_name == name]
        for run in range(min(len(trial.loops) for trial in own)):
            cycles = [trial.loops[run] for trial in own]
            low = max(float(x.min()) for cycle in cycles for x, _ in cycle)
            high = min(float(x.max()) for cycle in cycles for x, _ in cycle)
            grid = np.linspace(low, high, N_POINTS)
            push, pull = (np.concatenate([_at(grid, *cycle[i]) for cycle in cycles]) for i in (0, 1))
            energy = trapezoid(push - pull, grid, axis=1)
            bands = (np.quantile(push, LEVELS, axis=0), np.quantile(pull, LEVELS, axis=0))
            head = (name, run + 1, 0.5 * (high - low), peak_speed_mm_s, grid)
            out.append(LoopBand(*head, *bands, band_of(energy), len(own)))
    return tuple(out)


def _at(grid: FloatArray, x: FloatArray, force: FloatArray) -> FloatArray:
    """Force of every draw at the displacements of a grid."""
    order = np.argsort(x, kind="stable")
    return np.stack([np.interp(grid, x[order], row[order]) for row in force])


def write_loops(bands: Sequence[LoopBand], folder: Path) -> Path | None:
    """Write ``loops.csv``: one line per set, run and displacement; takes an old one away when there are no loops.

    Columns: set, n_devices, run, amplitude_mm, peak_speed_mm_s, displacement_mm, push_q05_kN, push_q50_kN,
    push_q95_kN (while displacement grows), pull_q05_kN, pull_q50_kN, pull_q95_kN (while it falls).
    """
    path = folder / LOOPS_CSV
    if not bands:
        path.unlink(missing_ok=True)
        return None
    parts = []
    for band in bands:
        columns: dict[str, Any] = {"set": safe_cell(band.set_name), "n_devices": band.n_devices, "run": band.run}
        columns |= {"amplitude_mm": band.amplitude_mm, "peak_speed_mm_s": band.peak_speed_mm_s}
        columns["displacement_mm"] = band.displacement_mm
        for side, force in (("push", band.push), ("pull", band.pull)):
            for level, values in zip(("q05", "q50", "q95"), force, strict=True):
                columns[f"{side}_{level}_kN"] = np.round(values, 4)
        parts.append(pd.DataFrame(columns))
    write_text(path, pd.concat(parts).to_csv(index=False, lineterminator="\n"))
    return path
