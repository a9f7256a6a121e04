"""Development trials of what devices of a set have in common: weak evidence in each, added over eight.

``python benchmarks/sets.py --seed 71 -n 3`` makes three sets of eight devices that wear by 0.6 to 0.8 % of Fy (what no
parameter of the law can take up) and three that hold nothing, with the simulators of the proof and seeds of
development; takes a first look at each device, adds the evidence, and prints per set the probability that it wears,
what else it is said to have, and what the devices say alone. All devices of a set are tested in one rig: its small
imperfections (below 1 % of Fy) are common to them. Every device is a line of ``build/sets/*.jsonl``; ``--again`` adds
the evidence of these lines anew.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.sets import DiagnosedDevice, common_to
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.results.codec import from_json
from shj_bayes.results.diagnosis import EvidenceRecord
from shj_validation.proof.cases import Key, stated_key
from shj_validation.proof.make import make
from shj_validation.proof.truth import fit_perfect

BUILD = Path(__file__).resolve().parents[1] / "build" / "sets"
SIZES = (0.006, 0.008)  # of Fy
ALIKE = 0.04  # spread of nominally identical devices
RATES_HZ = (5.0, 20.0)


def main() -> None:
    """Run the sets of one seed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of development")
    parser.add_argument("-n", "--n", type=int, default=2, help="number of sets with wear, and of sets without")
    parser.add_argument("--devices", type=int, default=8, help="of a set")
    parser.add_argument("--effect", default="wear", help="simulator")
    parser.add_argument("--again", action="store_true", help="add the evidence of earlier lines anew")
    arguments = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    path = BUILD / f"{arguments.effect}-seed{arguments.seed}.jsonl"
    if not arguments.again:
        with path.open("w") as file:
            for number in range(1, arguments.n + 1):
                for holds in (True, False):
                    for row in devices(arguments.seed, number, arguments.devices, arguments.effect, holds=holds):
                        file.write(json.dumps(row, allow_nan=False) + "\n")
                        file.flush()
                    show(path, (number, holds))
    else:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        for number, holds in dict.fromkeys((row["set"], row["holds"]) for row in rows):
            show(path, (number, holds))


def devices(seed: int, number: int, n: int, effect: str, *, holds: bool) -> list[dict[str, Any]]:
    """Make and diagnose the devices of a set."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, int(holds))))
    own = int(rng.integers(2**31))
    first = stated_key(
        effect,
        0.02,
        seed=own,
        protocol=str(rng.choice(["paper", "improved"])),
        rate_Hz=float(rng.choice(RATES_HZ)),
        reversal=str(rng.choice(["published", "continuous"])),
    )
    made, bare = make(first), make(first, effects=())
    whole = fit_perfect(first, made)
    part = whole.force_kN - np.concatenate([one.clean_kN for one in bare[:2]])
    visible = whole.share(whole.visible(part), first.device.Fy) / first.effects[0].size
    rows = []
    for i in range(n):
        device = first.device
        jitter = np.exp(ALIKE * rng.standard_normal(3))
        device = replace(device, K=device.K * jitter[0], Fy=device.Fy * jitter[1], beta=device.beta * jitter[2])
        size = float(rng.uniform(*SIZES)) / visible
        effects = (replace(first.effects[0], size=size),) if holds else ()
        key = replace(first, number=i + 1, device=device, effects=effects, entropy=int(rng.integers(2**62)))
        rows.append({"set": number, "holds": holds, "aimed": size * visible} | looked_at(key))
    return rows


def looked_at(key: Key) -> dict[str, Any]:
    """Take a first look at one device."""
    runs = runs_of([one.recording for one in make(key)])
    device = DeviceModel(len(runs), read_priors("afc"), variant=key.reversal)
    begin = time.process_time()
    record = diagnose(runs, device, DiagnoseOptions(quick=True)).content
    seconds = time.process_time() - begin
    kept = {name: record[name] for name in ("verdict", "evidence")}
    return {"key": key.to_dict(), "seconds": seconds, **kept}


def show(path: Path, which: tuple[int, bool]) -> None:
    """Print what a set has in common."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows = [row for row in rows if (row["set"], row["holds"]) == which]
    key = rows[0]["key"]
    alone = [" ".join(row["evidence"]["own"].values()) or "-" for row in rows]
    noise = f"{key['nuisance']['noise']} {key['nuisance']['noise_kN'] / key['device']['Fy']:.2%}"
    rig = f"{key['protocol']} {key['rate_Hz']:g} Hz {key['reversal']}, noise {noise} of Fy"
    seconds = np.median([row["seconds"] for row in rows])
    print(f"set {which[0]} {'with' if which[1] else 'without'}: {rig}; {seconds:.1f} s; alone: {', '.join(alone)}")
    for one in common_to([DiagnosedDevice(from_json(EvidenceRecord, row["evidence"])) for row in rows])[0]:
        if one.probability >= 0.05:
            sizes = [row["evidence"]["size_percent"].get(str(one.id), 0.0) for row in rows]
            each = " ".join(f"{p:.2f}" for p in one.of_devices)
            print(
                f"    {one.id!s:28} {one.probability:6.3f} {'enters' if one.enters else '':7} devices {each} "
                f"size {np.mean(sizes):.2f} % alone {sum(one.alone)}"
            )


if __name__ == "__main__":
    main()
