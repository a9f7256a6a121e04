"""Bands of the whole loop of a new device, first and second run, as values and as a CSV file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes.files import write_text
from shj_bayes.margins.sample import Motion
from shj_bayes.model.law import force_of_laws
from shj_bayes.population.loops import LoopBand, loop_band
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import SECOND_RUN, new_device
from shj_bayes.population.results import safe_cell

LOOPS_CSV = "loops.csv"
_NEEDED = ("K", "Fy", "beta", "gamma")


def loops(result: PopulationResult, motion: Motion | None) -> tuple[LoopBand, ...]:
    """Draw the loop bands of every set, both runs where both are known; of a set never tested last.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    motion : Motion or None
        The cycle. None, or a speed that was not tested, gives no loops: bounded laws of speed differ in shape too.

    Returns
    -------
    tuple of LoopBand
    """
    if motion is None or motion.guard.beyond:
        return ()
    return tuple(_loops(result, motion))


def _loops(result: PopulationResult, motion: Motion) -> Iterator[LoopBand]:
    law = partial(force_of_laws, variant=motion.guard.tested.variant)
    for name in (*result.set_names, ANY_SET):
        device = new_device(result, name)
        if not all(q in device.draws for q in _NEEDED):
            continue
        for run in (1, 2) if SECOND_RUN in device.draws else (1,):
            yield loop_band(
                device,
                law,
                amplitude_mm=motion.amplitude_mm,
                peak_speed_mm_s=motion.guard.speed_mm_s,
                run=run,
            )


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
        table = pd.DataFrame({"displacement_mm": band.displacement_mm})
        for side, force in (("push", band.push), ("pull", band.pull)):
            for level, values in zip(("q05", "q50", "q95"), force, strict=True):
                table[f"{side}_{level}_kN"] = np.round(values, 4)
        for i, (key, value) in enumerate(columns.items()):
            table.insert(i, key, value)
        parts.append(table)
    write_text(path, pd.concat(parts).to_csv(index=False, lineterminator="\n"))
    return path
