"""How many new devices lie beyond each limit, whatever is concealed: ``python benchmarks/margins_truth.py -n 10``.

Populations of simulated devices (the simulators of the proof) with one kind of physics concealed, each device with
its own share of it. Three (or six) of them are tested through Table 1, two runs, with noise; each is fitted with the
law alone or with the right effects (``rightly``: those that the simulator stands for; a kind outside the catalogue
has none), by the most probable parameters and the curvature there in place of sampling. From these the sheet is made.
New devices are simulated without noise, and the same reading is taken of their force. The table gives the share of
them beyond each limit. ``--out`` keeps one line a campaign, and goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from shj_bayes.inference.posterior import make_posterior
from shj_bayes.inference.run import runs_of
from shj_bayes.inference.start import find_start
from shj_bayes.margins.quantities import counted_from, of_readings
from shj_bayes.margins.row import HIGH, LOW, Margin
from shj_bayes.margins.sheet import margins, pool
from shj_bayes.margins.specimen import ALONE, FOUND, Belief, Specimen
from shj_bayes.margins.trial import Trial, readings_of, try_all
from shj_bayes.margins.virtual_test import read_off
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import Tags
from shj_bayes.population.posterior import DeviceSet, PopulationResult
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import Concealed, Key, stated_key
from shj_validation.proof.device import Device
from shj_validation.proof.make import Made, make
from shj_validation.proof.simulators.simulator import simulators_by_id

KINDS: dict[str, tuple[tuple[str, float], ...]] = {
    "nothing": (),
    "wear": (("wear", 0.06),),
    "wear in place": (("local_wear", 0.25),),
    "bedding-in": (("bedding_in", 0.25),),
    "asymmetry": (("asymmetry", 0.15),),
    "prying": (("prying", 0.15),),
    "slack": (("slack", 1.5),),
    "breakaway": (("breakaway", 0.2),),
    "heating": (("thermal", 0.15),),
    "end bearing": (("end_bearing", 0.3),),
    "two stage": (("two_stage", 0.35),),
    "wear and prying": (("wear", 0.04), ("prying", 0.1)),
    "outside": (("spatter", 0.15),),
}
OUTSIDE = ("local_wear", "spatter")
LEVEL = {"K": 15.0, "Fy": 75.0, "beta": 15.0}
SPREAD = {"K": 0.12, "Fy": 0.08, "beta": 0.3, "ratio": 0.05, "size": 0.2}
"""Standard deviation of the logarithm from device to device; gamma: 0.004 s/mm."""
N_NEW = 20
RATE_HZ = 10.0
N_LAPLACE = 32
LIMITS = (
    ("for drift and displacement", LOW, "lowest"),
    ("for capacity design", HIGH, "highest"),
    ("new device, 5 %", LOW, ""),
    ("new device, 95 %", HIGH, ""),
    ("tolerance 95/95 one-sided, lognormal, V unknown", LOW, ""),
    ("tolerance 95/95 one-sided, lognormal, V unknown", HIGH, ""),
    ("EN 1990 characteristic, lognormal, V unknown", LOW, ""),
    ("EN 1990 characteristic, lognormal, V unknown", HIGH, ""),
    ("ASCE 7 lower bound force", LOW, "lowest"),
    ("ASCE 7 upper bound force", HIGH, "highest"),
    ("EN 15129 LBDP, importance class II", LOW, "lowest"),
    ("EN 15129 UBDP, importance class II", HIGH, "highest"),
    ("phi equivalent, first run", LOW, "phi"),
    ("phi equivalent, after a first earthquake", LOW, "phi_2"),
    ("phi_o equivalent", HIGH, "phi_o"),
)
POOLED = ("lowest", "highest", "least", "least_2", "most", "most_2", "third")
SHOWN = {LOW: ("least", "least_2"), HIGH: ("most", "most_2")}
WORDS = """`python benchmarks/margins_truth.py` (`-n 0` writes this page from the kept campaigns). One set of three
tested devices a campaign, Table 1, two runs, 10 Hz, posteriors by the curvature at their top; spread from device to
device (standard deviation of the logarithm): Fy 0.08, ratio 0.05, size of what is concealed 0.2. Cells: mean share of
new devices beyond the limit; for 95/95 the share of campaigns in which at most 5 % are beyond. "limit / truth": median
of the limit over the 5 (95) % quantile of the new devices. So few campaigns tell a share to about 5 % (all kinds) and
20 % (one kind)."""
Readings = dict[str, float]


def key_of(kind: str, level: Device, rng: np.random.Generator) -> Key:
    """Draw one device of a population: its parameters and its share of what is concealed."""
    effects = KINDS[kind]
    first = effects[0] if effects else ("wear", 0.01)
    drawn = {q: getattr(level, q) * float(np.exp(rng.normal(0.0, SPREAD[q]))) for q in ("K", "Fy", "beta", "ratio")}
    drawn["gamma"] = level.gamma + 0.004 * float(rng.standard_normal())
    drawn["ratio"] = min(drawn["ratio"], 1.0)
    # The shape of what is concealed belongs to the population, its size to the device.
    key = stated_key(first[0], first[1], seed=int(rng.integers(2**31)), rate_Hz=RATE_HZ, **drawn)
    shape = np.random.default_rng(7)
    concealed = tuple(
        Concealed(name, size * float(np.exp(rng.normal(0.0, SPREAD["size"]))), simulators_by_id()[name].draw(shape))
        for name, size in effects
    )
    return replace(key, effects=concealed, kind=kind)


def tested(name: str, key: Key, found: tuple[str, ...], seed: int) -> Specimen:
    """Test a device and fit it with the law alone, and with what was found."""
    made = make(key)
    runs = runs_of([one.recording for one in made])
    beliefs = [_laplace(runs, (), ALONE, seed)]
    if found:
        beliefs.insert(0, _laplace(runs, found, FOUND, seed))
    posterior = make_posterior(runs, beliefs[0].model)
    starts = tuple(run.start_force_kN for run in runs)
    return Specimen(name, "set", tuple(beliefs), posterior.histories, starts, tuple(r.recording.force_kN for r in runs))


def _laplace(runs: tuple, effects: tuple[str, ...], label: str, seed: int) -> Belief:  # type: ignore[type-arg]
    model = DeviceModel(2, read_priors("afc"), effects=effects_named(effects))
    _, start = find_start(make_posterior(runs, model))
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(start.covariance + 1e-12 * np.eye(start.free.size))
    return Belief(label, model, model.natural(start.free + rng.standard_normal((N_LAPLACE, start.free.size)) @ root.T))


def truth(key: Key, least_amplitude: float) -> Readings:
    """Read what a device does off its force without noise."""
    made = make(key)
    runs = runs_of([_perfect(one) for one in made])
    out: Readings = {}
    for number, (run, one) in enumerate(zip(runs, made, strict=True), start=1):
        values = of_readings(read_off(one.clean_kN[None], run.motion, run.motion.travel_mm / 1000.0), least_amplitude)
        tail = "" if number == 1 else f"_{number}"
        out |= {f"{q}{tail}": float(values[q][0]) for q in ("least", "most", "third", "plateau")}
    out["lowest"], out["highest"] = min(out["least"], out["least_2"]), max(out["most"], out["most_2"])
    return out


def _perfect(one: Made) -> Recording:
    return Recording(one.recording.time_s, one.x_mm, one.clean_kN)


def campaign(kind: str, n_devices: int, seed: int) -> dict[int, dict[str, tuple[float, float]]]:
    """Share of new devices beyond every limit of one campaign, and the limit over their own 5 (95) %.

    By 1 (diagnosed rightly) and 0 (not at all).
    """
    rng = np.random.default_rng([seed, n_devices, list(KINDS).index(kind)])
    stiffness, force, beta = (LEVEL[q] * float(np.exp(rng.normal(0.0, 0.1))) for q in ("K", "Fy", "beta"))
    level = Device(stiffness, force, beta, float(rng.normal(0.0, 0.008)), float(rng.uniform(0.75, 0.95)))
    effects = tuple(name for name, _ in KINDS[kind] if name not in OUTSIDE)
    specimens = [tested(f"d{i}", key_of(kind, level, rng), effects, i) for i in range(n_devices)]
    least = max(counted_from(readings_of(s, s.histories)) for s in specimens)
    new = [truth(key_of(kind, level, rng), least) for _ in range(N_NEW)]
    alone = [replace(s, beliefs=s.beliefs[-1:]) for s in specimens]
    return {
        found: _limits(devices, new, seed) for found, devices in ((1, specimens), (0, alone)) if effects or not found
    }


def _limits(specimens: list[Specimen], new: list[Readings], seed: int) -> dict[str, tuple[float, float]]:
    trials = tuple(replace(t, values={q: t.values[q] for q in POOLED}) for t in try_all(specimens, None))
    sheet = margins(pool(trials, _sets(trials, seed)), trials)
    nominal = next(row.value for row in sheet.rows if row.kind == "nominal sliding force")
    out = {}
    for kind_of_row, side, what in LIMITS:
        for quantity in (what,) if what else SHOWN[side]:
            row = sheet.get("set", "force" if what else quantity, kind_of_row, side)
            if row is not None and np.isfinite(row.value):
                out[f"{kind_of_row}|{side}|{quantity}"] = _beyond(row, quantity, new, nominal)
    return out


def _beyond(row: Margin, quantity: str, new: list[Readings], nominal: float) -> tuple[float, float]:
    low, high = (np.array([one[q] for one in new]) for q in ("lowest", "highest"))
    of_row = {"phi": "least", "phi_2": "least_2"}.get(quantity, quantity)
    value = row.value * (nominal if quantity.startswith("phi") else 1.0)
    values: FloatArray = np.array([one[of_row] for one in new]) if of_row in new[0] else low
    if row.side == HIGH:
        values = values if quantity in SHOWN[HIGH] else high
        return float(np.mean(values > value)), value / float(np.quantile(values, 0.95))
    return float(np.mean(values < value)), value / float(np.quantile(values, 0.05))


def _sets(trials: tuple[Trial, ...], seed: int) -> PopulationResult:
    group = DeviceSet("set", tuple(t.name for t in trials), Tags(), {})
    return PopulationResult((group,), {}, {}, {}, {}, seed)


def report(lines: list[dict[str, object]]) -> str:
    """Tables of the share beyond each limit, per cent, by kind and by what the diagnosis found.

    "limit / truth" is the median of the limit over the 5 (95) % of the new devices themselves.
    """
    out = []
    for n_devices, found in sorted({(line["devices"], line["found"]) for line in lines}, key=str):
        own = [line for line in lines if (line["devices"], line["found"]) == (n_devices, found)]
        shares: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        width: dict[str, list[float]] = defaultdict(list)
        for line in own:
            for limit, (share, over) in line["beyond"].items():  # type: ignore[attr-defined]
                shares[limit][str(line["kind"])].append(share)
                width[limit].append(over)
        kinds = [k for k in KINDS if any(line["kind"] == k for line in own)]
        counts = ", ".join(f"{k} {sum(line['kind'] == k for line in own)}" for k in kinds)
        word = "diagnosed rightly" if found else "not diagnosed"
        out.append(f"\n## {n_devices} tested devices, {word}\n\nCampaigns: {counts}; {N_NEW} new devices each.\n")
        out.append(
            f"| limit | side | quantity | {' | '.join(kinds)} | all | limit / truth |\n"
            f"|---|---|---|{'---|' * (len(kinds) + 2)}"
        )
        for limit, by_kind in shares.items():
            confident = "95/95" in limit
            cells = []
            for kind in kinds:
                values = np.array(by_kind.get(kind, [np.nan]))
                cells.append(100.0 * float(np.mean(values <= 0.05) if confident else np.mean(values)))
            together = np.concatenate([by_kind[k] for k in by_kind])
            everything = 100.0 * float(np.mean(together <= 0.05) if confident else np.mean(together))
            name = limit.replace("|", " | ") + (" (held, %)" if confident else "")
            out.append(
                f"| {name} | {' | '.join(f'{c:.1f}' for c in cells)} | **{everything:.1f}** "
                f"| {np.median(width[limit]):.2f} |"
            )
    return "\n".join(out) + "\n"


def main() -> None:
    """Run campaigns and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-n", type=int, default=10, help="campaigns of each kind (10)")
    parser.add_argument("--devices", type=int, nargs="+", default=[3], help="tested devices (3)")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--out", type=Path, default=Path("reports/margins-truth.jsonl"))
    arguments = parser.parse_args()
    lines = [json.loads(t) for t in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    done = {(line["kind"], line["devices"], line["found"], line["seed"]) for line in lines}
    for c in range(arguments.n):
        for n_devices in arguments.devices:
            for kind in arguments.kinds:
                seed = arguments.seed + c
                if any((kind, n_devices, found, seed) in done for found in (0, 1)):
                    continue
                for found, beyond in campaign(kind, n_devices, seed).items():
                    line = {"kind": kind, "devices": n_devices, "found": found, "seed": seed, "beyond": beyond}
                    lines.append(line)
                    with arguments.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(line) + "\n")
    page = f"# New devices beyond each limit, per cent\n\n{WORDS}\n{report(lines)}"
    arguments.out.with_suffix(".md").write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
