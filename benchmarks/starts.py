"""Devices that begin in any way, with nothing missing: a constant force named, intervals that miss the truth.

    python benchmarks/starts.py 1 40

Each device is fitted and looked at. It begins at rest and unloaded, at rest with a force of an earlier test in it, in
motion, or in motion and cut, with white, slow or displaced noise, at 5 to 200 Hz, under either rule of reversal. The
law is written out here, at the instants of the readings of a motion that is known in between, so nothing is averaged.
"""

from __future__ import annotations

import sys
from itertools import product

import numpy as np
from numpy.typing import NDArray

from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.motion import Block, table_1
from shj_bayes.recording.recording import Recording

Floats = NDArray[np.float64]
BEGINS = ("at rest", "loaded", "in motion", "cut")
NOISES = ("white", "slow", "displaced")
RATES_HZ = (5.0, 20.0, 50.0, 200.0)
RULES = ("continuous", "published")
REST_S = 3.0


def motion(time_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Displacement (mm) and speed (mm/s) of Table 1 at any times, and its turning points (mm) in their order."""
    begins = np.cumsum([0.0, *(block.duration_s for block in table_1())])
    own = np.clip(np.searchsorted(begins, time_s, side="right") - 1, 0, len(table_1()) - 1)
    amplitude = np.array([block.amplitude_mm for block in table_1()])[own]
    pulse = 2.0 * np.pi * np.array([block.frequency_Hz for block in table_1()])[own]
    phase = pulse * (time_s - begins[own])
    moves = time_s >= 0.0
    turning = np.concatenate([np.tile([b.amplitude_mm, -b.amplitude_mm], b.n_cycles) for b in table_1()])
    return np.where(moves, amplitude * np.sin(phase), 0.0), np.abs(amplitude * pulse * np.cos(phase)) * moves, turning


def force(time_s: Floats, law: dict[str, float], begin_kN: float, rule: str) -> Floats:
    """Force of Eq. (1) with Eq. (2), kN, with `begin_kN` in the device at time 0."""
    x, speed, turning = motion(time_s)
    ends = np.concatenate([b + np.arange(1, 4 * t.n_cycles, 2) / (4.0 * t.frequency_Hz) for b, t in _begun()])
    half = np.searchsorted(ends, time_s, side="right")

    def held(elastic: Floats, sense: float) -> Floats:
        slides = elastic / (1.0 + np.abs(elastic / law["Fy"]) ** law["beta"]) ** (1.0 / law["beta"])
        return np.where((rule == "continuous") & (elastic * sense < 0.0), elastic, slides)

    out, reset, origin = np.empty(time_s.size), begin_kN, 0.0
    for k, end in enumerate([*turning, x[-1]]):
        sense, own = (1.0 if k % 2 == 0 else -1.0), half == k
        out[own] = held(law["K"] * (x[own] - origin) + reset, sense)
        reset, origin = float(held(np.array(law["K"] * (end - origin) + reset), sense)), float(end)
    return out * (1.0 + law["gamma"] * speed)


def _begun() -> list[tuple[float, Block]]:
    return list(zip(np.cumsum([0.0, *(b.duration_s for b in table_1())]), table_1(), strict=False))


def device(seed: int) -> tuple[str, list[Recording], dict[str, float], str]:
    """Two runs of a device, with its truth and rule."""
    rng = np.random.default_rng([seed, 77])
    begin, noise, rate, rule = list(product(BEGINS, NOISES, RATES_HZ, RULES))[rng.integers(96)]
    law = {"K": rng.uniform(8, 25), "Fy": rng.uniform(60, 120), "beta": rng.choice([4.0, 10.0, 30.0]), "gamma": 0.0}
    law["gamma"] = 1.0 / rng.choice([-90.0, 60.0, 150.0, 1e9])
    runs = []
    for run in (1, 2):
        own = law | {"Fy": law["Fy"] * (1.0 if run == 1 else 0.85)}
        first = {"at rest": -REST_S, "loaded": -REST_S, "in motion": 0.0, "cut": rng.uniform(0.1, 0.4)}[begin]
        time = np.arange(first, sum(block.duration_s for block in table_1()), 1.0 / rate)
        # Readings lie anywhere between the corners of the motion, not on them.
        time += rng.uniform(0.0, 1.0 / rate)
        clean = force(time, own, rng.uniform(-0.5, 0.5) * own["Fy"] if begin == "loaded" else 0.0, rule)
        x, _, _ = motion(time)
        x = x + (0.05 if noise == "displaced" else 0.005) * rng.standard_normal(time.size)
        slow, decay = np.zeros(time.size), np.exp(-1.0 / (3.0 * rate))
        for i in range(1, time.size if noise == "slow" else 0):
            slow[i] = decay * slow[i - 1] + np.sqrt(1.0 - decay**2) * 0.8 * rng.standard_normal()
        white = (0.4 if noise == "slow" else 1.0) * rng.standard_normal(time.size)
        runs.append(Recording(time - time[0], x, clean + slow + white))
    return f"{begin}, {noise}, {rate:g} Hz, {rule}", runs, law | {"ratio": 0.85}, rule


def main() -> None:
    """Print a line for each device, then how many are right."""
    first, n = int(sys.argv[1]), int(sys.argv[2])
    inside: dict[str, list[bool]] = {}
    constant, alarms, worse = 0, 0, 0
    for seed in range(first, first + n):
        title, recordings, truth, rule = device(seed)
        runs = runs_of(recordings)
        model = DeviceModel(2, read_priors("afc"), variant=rule)
        draws = fit(runs, model, name="device", plan=SamplingPlan(seed=seed)).data["posterior"]
        outside = []
        for name, value in truth.items():
            low, high = np.quantile(draws[name].to_numpy(), [0.05, 0.95])
            inside.setdefault(name, []).append(bool(low <= value <= high))
            outside += [] if inside[name][-1] else [name]
        record = diagnose(runs, model, DiagnoseOptions(quick=True)).content
        said = [e["id"] for e in record["effects"]] + [f"{m['id']}?" for m in record["family"]]
        constant += any("load_offset" in word for word in said)
        alarms += record["verdict"] != "adequate"
        errors = [record[stage]["heldout_rmse_kN"] for stage in ("before", "after")]
        worse += errors[1] > errors[0] + record["heldout"]["rmse_se_kN"]
        print(
            f"{seed:4d} {title:40s} {record['verdict']:9s} {' '.join(said):30s} error on cycles left out "
            f"{errors[0]:.2f} -> {errors[1]:.2f} kN; outside 90 %: {' '.join(outside) or 'none'}",
            flush=True,
        )
    print(f"\n{n} devices: a constant force named in {constant}, something said in {alarms}, worse in {worse}")
    print("90 % intervals hold: " + ", ".join(f"{name} {np.mean(v):.0%}" for name, v in inside.items()))


if __name__ == "__main__":
    main()
