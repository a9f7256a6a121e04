"""Simulated recordings as files, labelled as such, with their truth beside them."""

import json
from dataclasses import asdict
from pathlib import Path

from shj_bayes._util.files import write_text
from shj_bayes.errors import ModelError
from shj_bayes.model.parameters import BASE, describe
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import table_1
from shj_bayes.recording.recording import write_csv


def gamma_of(dep_mm_s: float | None) -> float:
    """Speed coefficient, s/mm, of a dep, mm/s; None is no speed dependence."""
    if dep_mm_s == 0:
        raise ModelError("dep = 0 mm/s: allowed is any other number; leave --dep out for no speed dependence")
    return 0.0 if dep_mm_s is None else 1 / dep_mm_s


def write_simulated(
    stem: Path, truth: Truth, *, seed: int, rate_Hz: float, last_cycles: int = 5, model: str = "published"
) -> list[Path]:
    """Simulate two runs of Table 1 and write ``STEM-run1.csv``, ``STEM-run2.csv`` and the truth, ``STEM.json``.

    The same seed gives the same files.
    """
    blocks = table_1(last_cycles)
    recordings = simulate_device(truth, seed=seed, rate_Hz=rate_Hz, blocks=blocks, variant=model)
    stem.parent.mkdir(parents=True, exist_ok=True)
    words = f"SIMULATED by shj-bayes, seed {seed}; not a measurement. Truth: {stem.name}.json"
    paths = [
        write_csv(stem.with_name(f"{stem.name}-run{run}.csv"), recording, comment=words)
        for run, recording in enumerate(recordings, start=1)
    ]
    content = {
        "schema": "shj-bayes/truth/1",
        "simulated": True,
        "seed": seed,
        "model": model,
        "rate_Hz": rate_Hz,
        "blocks": [asdict(block) for block in blocks],
        "truth": asdict(truth),
        "units": {name: describe(name).unit for name in asdict(truth) if name in BASE},
    }
    path = stem.with_name(f"{stem.name}.json")
    write_text(path, json.dumps(content, indent=1))
    return [*paths, path]
