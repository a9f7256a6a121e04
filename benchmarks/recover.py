"""Fit a recording simulated from each of the 25 published rows and print where the truth lies.

``python benchmarks/recover.py`` prints one line per row and the share of (row, parameter) pairs whose truth is inside
the 95 % interval. Two runs of Table 1 at 20 Hz, white force noise of 0.8 kN, slow noise of 0.6 kN (3 s), displacement
noise 0.02 mm; half-cycles and speed come from the noisy displacement, as for a measured recording. ``--seed`` draws
other noise, ``--rows`` takes fewer rows, ``--rate`` another sampling rate.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.device import published_rows

TARGET = 0.92
NOISE = {"sigma_white": "sigma"}  # what the noise without memory is called in the truth


def main() -> None:
    """Run the fits and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--rows", type=int, default=25)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    records = [recover(row, arguments.seed + i, arguments.rate) for i, row in enumerate(rows()[: arguments.rows])]
    pairs = [inside for record in records for inside in record["inside"].values()]
    print(f"\ntruth inside the 95 % interval: {sum(pairs)} of {len(pairs)} pairs = {100 * np.mean(pairs):.1f} %")
    print(
        f"(target {100 * TARGET:.0f} %); reliable: {sum(r['verdict'] == 'reliable' for r in records)} of {len(records)}"
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=1), encoding="utf-8")


def rows() -> list[tuple[str, Truth]]:
    """Name and truth of each published row."""
    out = []
    for row in published_rows():
        stiffness, capacity, beta = (row.values[name, 1] for name in ("K", "Fy", "beta"))
        truth = Truth(stiffness, capacity, beta, row.gamma, row.ratio, sigma=0.8, phi=0.0, sigma_slow=0.6, tau_slow=3.0)
        out.append((f"T{row.table} {row.row}", truth))
    return out


def recover(row: tuple[str, Truth], seed: int, rate: float) -> dict[str, Any]:
    """Simulate and fit one row; print its line."""
    name, truth = row
    begin = time.perf_counter()
    runs = runs_of(simulate_device(truth, seed=seed, rate_Hz=rate))
    result = fit(runs, DeviceModel(len(runs), read_priors("afc")), name=name, plan=SamplingPlan(seed=seed))
    inside, cells = {}, []
    for parameter in result.likelihood.model.names:
        draws = result.data["posterior"][parameter].to_numpy().ravel()
        low, high = np.quantile(draws, [0.025, 0.975])
        true = getattr(truth, NOISE.get(parameter, parameter))
        inside[parameter] = bool(low <= true <= high)
        z = (draws.mean() - true) / draws.std()
        cells.append(f"{parameter} {draws.mean():.4g} ({z:+.1f}){'' if inside[parameter] else ' OUT'}")
    seconds = time.perf_counter() - begin
    print(f"{name:32}{result.verdict.word:10}{seconds:5.0f} s  " + "  ".join(cells), flush=True)
    return {"row": name, "verdict": result.verdict.word, "seconds": seconds, "inside": inside}


if __name__ == "__main__":
    main()
