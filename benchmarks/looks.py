"""How long a first look and a full one take for each effect: a device of 24 000 samples, whose tests hold one effect.

``python benchmarks/looks.py`` prints a line for each effect of the proof's simulators, and one for a device with
nothing concealed: the answer of the first look, and the seconds that a user waits for each look, pages included. Two
runs of the paper's Table 1; run it on a quiet machine. ``--effect wear`` takes one; ``--first`` leaves full looks out.
"""

from __future__ import annotations

import argparse
import time
from tempfile import TemporaryDirectory

import numpy as np

import shj_bayes
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import stated_key
from shj_validation.proof.make import make
from shj_validation.proof.simulators.simulator import simulators_by_id

SEED = 7
RULE = "continuous"  # of the rig, and of the model
SIZE = 0.08  # of Fy, where nothing else is said; others in the unit of their simulator
SIZES = {
    "inertia": 8000.0,
    "slack": 1.0,
    "sensor_lag": 0.15,
    "wear": 0.02,
    "amplitude": 0.03,
    "stick_slip": 0.1,
    "local_wear": 0.2,
    "two_stage": 0.2,
    "end_bearing": 0.2,
}


def main() -> None:
    """Time the looks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--effect", action="append", help="one effect; all by default")
    parser.add_argument("--first", action="store_true", help="first looks only")
    arguments = parser.parse_args()
    known = [name for name, one in simulators_by_id().items() if one.inside and name == one.effect]
    shj_bayes.diagnose(recordings("prying", 0.0), model=RULE, quick=True)  # compiles what is compiled once
    longest: dict[bool, list[tuple[float, str]]] = {True: [], False: []}
    for name in arguments.effect or ["nothing", *known]:
        tests = recordings("prying", 0.0) if name == "nothing" else recordings(name, SIZES.get(name, SIZE))
        words = f"{name:18} {sum(one.force_kN.size for one in tests):6} samples"
        for quick in (True, False)[: 1 if arguments.first else 2]:
            begin = time.perf_counter()
            with TemporaryDirectory() as folder:
                record = shj_bayes.diagnose(tests, folder, model=RULE, quick=quick, progress=False).record
            seconds = time.perf_counter() - begin
            longest[quick].append((seconds, name))
            found = "+".join(effect["id"] for effect in record["effects"])
            words += f" | {'first' if quick else 'full'} {seconds:5.1f} s {record['verdict']} {found}"
        print(words, flush=True)
    for quick, own in longest.items():
        if own:
            seconds, name = max(own)
            middle = float(np.median([one for one, _ in own]))
            print(f"{'first' if quick else 'full'}: {middle:.1f} s in the middle, {seconds:.1f} s at most ({name})")


def recordings(name: str, size: float) -> list[Recording]:
    """Two runs of Table 1 with an effect of a size."""
    return [one.recording for one in make(stated_key(name, size, seed=SEED, reversal=RULE))]


if __name__ == "__main__":
    main()
