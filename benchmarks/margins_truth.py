"""How many new devices lie beyond each limit, whatever is concealed: ``python benchmarks/margins_truth.py -n 200``.

Populations of simulated devices (the simulators of the proof) with one kind of physics concealed, each device with its
own share of it. Every device goes through Table 1, two runs, with noise; limits are drawn up from the recordings alone
and, in ``--fitted`` populations of each kind, from three fits besides: with the law alone, with the right effects
(those that the simulator stands for) and with a wrong one (``WRONG``), by the most probable parameters and the
curvature there in place of sampling. A campaign draws some devices of a population at random as
the tested ones; the others are its new devices, of whose force without noise the same reading is taken. The rows of
the sheet come from the code itself; the posterior of a single set is found by quadrature in place of Markov chains,
which is exact and a thousand times as fast (``tests/oracle/test_one_set.py`` holds the two against each other).

Simulated devices are kept, one line a population, in ``--bank``; a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from one_set import draws_of_one_set, level_and_spread

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.binning import Run, runs_of
from shj_bayes.inference.likelihood import make_likelihood
from shj_bayes.inference.start import _best_noise as best_noise
from shj_bayes.inference.start import _covariance as curvature
from shj_bayes.inference.start import descend, find_start, law_residual
from shj_bayes.margins.basis import (
    DEFAULT,
    NONE,
    DesignBasis,
    Environment,
    force_ends,
    predictive_devices,
    sliding_force_bounds,
)
from shj_bayes.margins.codes.code import Given, catalogue
from shj_bayes.margins.specimen import Belief, Specimen
from shj_bayes.margins.spread import HIGH, LOW, Sample, common_spread, of_set
from shj_bayes.margins.uses import OneSet, of_many
from shj_bayes.margins.virtual_test import LEAST_ERROR, own_readings, virtual_tests
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.priors import read_priors
from shj_bayes.options import PLAIN
from shj_bayes.population.device import NO_TAGS
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import NewDevice
from shj_bayes.population.quantities import other_priors, population_prior
from shj_bayes.population.readings import Readings, counted_from, of_readings, pooled, read_off
from shj_bayes.results.campaign import Connection
from shj_validation.proof.cases import Concealed, Key, stated_key
from shj_validation.proof.device import Device
from shj_validation.proof.make import make
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
WRONG = {
    "nothing": "wear",
    "wear": "thermal",
    "wear in place": "wear",
    "bedding-in": "breakaway",
    "asymmetry": "prying",
    "prying": "end_bearing",
    "slack": "two_stage",
    "breakaway": "bedding_in",
    "heating": "wear",
    "end bearing": "prying",
    "two stage": "slack",
    "wear and prying": "thermal",
    "outside": "asymmetry",
}
"""An effect that is taken for what is concealed: the nearest other one, where there is one."""
STATES = {
    "recordings": "recordings alone, no model",
    "not": "law alone, not diagnosed",
    "rightly": "diagnosed rightly",
    "wrongly": "diagnosed wrongly",
}
LEVEL = {"K": 15.0, "Fy": 75.0, "beta": 15.0}
SPREAD = {"K": 0.12, "Fy": 0.08, "beta": 0.3, "ratio": 0.05, "size": 0.2}
"""Standard deviation of the logarithm from device to device; gamma: 0.004 s/mm."""
N_DEVICES = {False: 15, True: 9}
"""Devices of a population; of one whose devices are fitted, fewer."""
RATE_HZ = 10.0
N_LAPLACE = 32
POOLED = ("lowest", "highest", "least", "least_2", "most", "most_2", "plateau", "plateau_2", "third")
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
    ("phi equivalent, first run", LOW, "least"),
    ("phi equivalent, after a first earthquake", LOW, "least_2"),
)
"""LBDP, UBDP and phi_o rest on the same force as the first two where no corroded set was tested."""
CONNECTIONS = (1, 4, 20)
MANY: tuple[tuple[str, str, Callable[..., FloatArray]], ...] = (
    ("sum", LOW, np.sum),
    ("sum", HIGH, np.sum),
    ("largest", HIGH, np.max),
)
N_JOINT = 1000
"""Draws of level and spread of a set."""
Cell = tuple[str, int, str]
"""Kind, population, state."""
SHOWN = {LOW: ("lowest", "least", "least_2"), HIGH: ("highest", "most", "most_2")}
WORDS = """`python benchmarks/margins_truth.py {asked}` (simulated devices are in `margins-truth.jsonl`;
without that file they are made again). Table 1, two runs, 10 Hz. Where devices are fitted, with the law alone, with
the right effects and with a wrong one, by the most probable parameters and the curvature there. Spread from device to
device (standard deviation of the logarithm): Fy 0.08, ratio 0.05, size of what is concealed 0.2. One set a campaign.

Cells: mean share of new devices beyond the limit, per cent; of 95/95 limits the share of campaigns in which they hold,
that is lie beyond the 5 (95) % end of the population. "all": mean over all populations and its 95 % interval from how
they differ. "limit / truth": median of the limit over that end. "sum" and "largest" of so many connections of one
delivery: share of deliveries beyond, of four thousand drawn. "at any speed": of the least (largest) force in the same
strokes at the tested speed and next to standstill. LBDP, UBDP and phi_o are the forces of the first two
rows, since no corroded set was tested."""
Line = dict[str, Any]


def level_of(kind: str, seed: int) -> tuple[Device, np.random.Generator]:
    """Typical device of a population, and the chance that makes its devices."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    stiffness, force, beta = (LEVEL[q] * float(np.exp(rng.normal(0.0, 0.1))) for q in ("K", "Fy", "beta"))
    return Device(stiffness, force, beta, float(rng.normal(0.0, 0.008)), float(rng.uniform(0.75, 0.95))), rng


def draw(kind: str, level: Device, rng: np.random.Generator, n: int) -> FloatArray:
    """Draw devices: logarithms of K, Fy, beta, ratio and of the size of what is concealed; gamma, shape (n, 5 + k)."""
    sizes = [size for _, size in KINDS[kind]]
    centre = np.log([level.K, level.Fy, level.beta, level.ratio, *sizes])
    spread = [*(SPREAD[q] for q in ("K", "Fy", "beta", "ratio")), *(SPREAD["size"] for _ in sizes)]
    logs = centre + spread * rng.standard_normal((n, centre.size))
    logs[:, 3] = np.minimum(logs[:, 3], 0.0)
    return np.column_stack([logs, level.gamma + 0.004 * rng.standard_normal(n)])


def key_of(kind: str, row: FloatArray, rng: np.random.Generator) -> Key:
    """Key of a device; the shape of what is concealed belongs to the population, its size to the device."""
    first = KINDS[kind][0][0] if KINDS[kind] else "wear"
    stiffness, force, beta, ratio, *sizes = (float(x) for x in np.exp(row[:-1]))
    parts = Device(stiffness, force, beta, float(row[-1]), ratio)
    key = stated_key(first, 0.01, seed=int(rng.integers(2**31)), rate_Hz=RATE_HZ, **asdict(parts))
    shape = np.random.default_rng(7)
    concealed = tuple(
        Concealed(name, size, simulators_by_id()[name].draw(shape))
        for (name, _), size in zip(KINDS[kind], sizes, strict=True)
    )
    return replace(key, effects=concealed, kind=kind)


def population(kind: str, seed: int, *, fitted: bool) -> Line:
    """Simulate and test the devices of a population: what each gives the sheet, and the truth about it."""
    level, rng = level_of(kind, seed)
    drawn = draw(kind, level, rng, N_DEVICES[fitted])
    keys = [key_of(kind, row, rng) for row in drawn]
    tests = [make(key) for key in keys]
    runs = [runs_of([one.recording for one in made]) for made in tests]
    true = [_read(own, [one.clean_kN for one in made]) for own, made in zip(runs, tests, strict=True)]
    seen = [_read(own, [r.recording.force_kN for r in own], measured=True) for own in runs]
    slow = [make(key, speed_share=0.0) for key in keys] if fitted else []
    at_rest = [_read(own, [one.clean_kN for one in made]) for own, made in zip(runs, slow, strict=fitted)]
    least = max(counted_from(one) for one in true)
    out: Line = {"kind": kind, "seed": seed, "drawn": drawn.tolist(), "states": {}}
    out["states"]["recordings"] = {
        "values": _listed([_pooled(one, least) for one in seen]),
        "errors": {q: [LEAST_ERROR] * len(drawn) for q in POOLED},
        "truth": _listed([_pooled(one, least) for one in true]),
    }
    if not fitted:
        return out
    right = tuple(name for name, _ in KINDS[kind] if name not in OUTSIDE)
    beliefs = {"not": (), "rightly": right, "wrongly": (WRONG[kind],)}
    tops: dict[tuple[str, ...], FloatArray] = {}
    devices = [tested(f"d{i}", own, list(beliefs.values()), i, tops) for i, own in enumerate(runs)]
    for i, state in enumerate(beliefs):
        if i and not beliefs[state]:
            continue
        chosen = [replace(d, beliefs=(*d.beliefs[i : i + 1], *d.beliefs[:1]) if i else d.beliefs[:1]) for d in devices]
        trials = virtual_tests(chosen, None)
        least = max(counted_from(own_readings(device)) for device in chosen)
        as_tested, rest = (_listed([_pooled(one, least) for one in read]) for read in (true, at_rest))
        out["states"][state] = {
            "values": _listed([t.values for t in trials]),
            "errors": _listed([t.errors for t in trials]),
            "truth": as_tested,
            # over both speeds, tested and next to standstill
            "at any speed": {
                q: [(min if q == "lowest" else max)(pair) for pair in zip(as_tested[q], rest[q], strict=True)]
                for q in ("lowest", "highest")
            },
        }
    return out


def _read(runs: tuple[Run, ...], forces: list[FloatArray], *, measured: bool = False) -> tuple[Readings, ...]:
    return tuple(
        read_off(force[None], run.motion, run.motion.travel_mm / 1000.0, measured=measured)
        for run, force in zip(runs, forces, strict=True)
    )


def _pooled(readings: tuple[Readings, ...], least: float) -> dict[str, float]:
    return {q: float(v[0]) for q, v in pooled([of_readings(one, least) for one in readings])}


def _listed(devices: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    return {q: [one[q] for one in devices] for q in POOLED}


def tested(
    name: str,
    runs: tuple[Run, ...],
    found: list[tuple[str, ...]],
    seed: int,
    tops: dict[tuple[str, ...], FloatArray],
) -> Specimen:
    """Fit a device with the law alone, and with what was found; None in place of a fit that is not asked for."""
    beliefs = [_laplace(runs, effects, seed, tops) if effects or not i else None for i, effects in enumerate(found)]
    posterior = make_likelihood(runs, beliefs[0].model)  # type: ignore[union-attr]
    starts = tuple(run.start_force_kN for run in runs)
    forces = tuple(r.recording.force_kN for r in runs)
    return Specimen(name, "set", tuple(beliefs), posterior.histories, starts, forces)  # type: ignore[arg-type]


def _laplace(
    runs: tuple[Run, ...], effects: tuple[str, ...], seed: int, tops: dict[tuple[str, ...], FloatArray]
) -> Belief:
    """Draws of a normal posterior; the search begins at the top of another device of the population."""
    model = DeviceModel(2, read_priors("afc"), effects=effects_named(effects))
    posterior = make_likelihood(runs, model)
    if effects in tops:
        z = descend(posterior, tops[effects], float(np.std(law_residual(posterior, tops[effects]))))
        posterior = posterior.refined(z)
        top = best_noise(posterior, z)
        spread = curvature(posterior, top)
        # One step of Newton's: squares know nothing of slow noise.
        step = 1e-2 * np.sqrt(np.diag(spread))
        both = posterior.log_posterior_free(top + np.vstack([np.diag(step), -np.diag(step)]))
        moved = top + spread @ ((both[: top.size] - both[top.size :]) / (2.0 * step))
        before, after = posterior.log_posterior_free(np.array([top, moved]))
        top = moved if after > before else top
    else:
        _, start = find_start(posterior)
        top, spread = start.free, start.covariance
    tops[effects] = top[: model.n_law]
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(spread + 1e-12 * np.eye(top.size))
    return Belief(model, model.laws.natural(top + rng.standard_normal((N_LAPLACE, top.size)) @ root.T))


def limits(state: Line, chosen: list[int]) -> dict[str, float]:
    """Limits of the sheet from some devices of a population, by kind of limit, side and quantity."""
    values = {q: np.array(v)[chosen] for q, v in state["values"].items()}
    errors = {q: np.array(v)[chosen] for q, v in state["errors"].items()}
    n = len(chosen)
    main = {q: population_prior(q) for q in POOLED}
    by_prior = {DEFAULT: main} | {
        label: {q: other_priors(prior)[label] for q, prior in main.items()} for label in other_priors(main[POOLED[0]])
    }
    devices = {
        label: NewDevice(
            "set", n, {q: np.exp(draws_of_one_set(np.log(values[q]), errors[q], prior[q])) for q in POOLED}
        )
        for label, prior in by_prior.items()
    }
    force = sliding_force_bounds(devices, dict.fromkeys(POOLED, n))
    ends = force_ends(devices, dict.fromkeys(POOLED, n))
    parts = DesignBasis(force.third, "typical device", force, Environment(NONE, NONE, "not tested"))
    samples = {q: Sample(values[q], float(np.sqrt(np.mean(errors[q] ** 2)))) for q in (*SHOWN[LOW], *SHOWN[HIGH])}
    spreads = {q: of_set(sample, common_spread([sample])) for q, sample in samples.items()}
    given = Given("set", samples, spreads, dict.fromkeys(samples, n), parts, PLAIN)
    rows = {
        (r.kind, r.side, r.quantity): r.value for code in catalogue() if code.id != "en15129" for r in code.rows(given)
    }
    found = {"for drift and displacement|low|lowest": force.low, "for capacity design|high|highest": force.high}
    if "at any speed" in state:
        found |= {f"{name.partition('|')[0]}, at any speed|{name.partition('|')[2]}": v for name, v in found.items()}
    found |= together(values, errors, by_prior, given)
    for kind, side, quantity in LIMITS:
        if kind.startswith("for "):
            continue
        for q in (quantity,) if quantity else SHOWN[side]:
            if kind.startswith("new device"):
                value = ends[q, side][0]
            else:
                value = rows[kind, side, "force" if quantity else q]
                value *= force.third if kind.startswith("phi") else 1.0
            found[f"{kind}|{side}|{q}"] = value
    return found


def together(
    values: Mapping[str, FloatArray],
    errors: Mapping[str, FloatArray],
    by_prior: Mapping[str, Mapping[str, Any]],
    given: Given,
) -> dict[str, float]:
    """Bounds of the sum and of the largest of connections, by the code of the sheet itself."""
    n = values["lowest"].size
    fits = {
        label: {q: _posterior(q, values[q], errors[q], prior[q], label) for q in ("lowest", "highest")}
        for label, prior in by_prior.items()
    }
    points = {q: tuple(np.log(values[q])) for q in fits[DEFAULT]}
    group = DeviceSet("set", tuple(map(str, range(n))), NO_TAGS, points, {q: tuple(errors[q]) for q in points})
    result = PopulationResult((group,), fits.pop(DEFAULT), fits, {}, {}, n)
    one = OneSet(given, result, predictive_devices(result, "set"), Connection())
    found = {}
    for count in CONNECTIONS:
        for word, side, take in MANY:
            q = "lowest" if side == LOW else "highest"
            found[f"{word} of {count}|{side}|{q}"] = of_many(one, side, count, partial(take, axis=0))[0]
    return found


def _posterior(name: str, values: FloatArray, errors: FloatArray, prior: Any, label: str) -> QuantityPosterior:
    """Posterior of a single set by quadrature, in the form of a population of one."""
    rng = np.random.default_rng([*name.encode(), *label.encode()])
    level, spread = level_and_spread(np.log(values), errors, prior, N_JOINT, rng)
    hyper = np.ones((N_JOINT, 4))
    return QuantityPosterior(name, level[:, None], spread[:, None], hyper, (values.size,))


def devices_of(lines: list[Line], seed: int) -> dict[tuple[str, int, str, str, str], FloatArray]:
    """Draw 4000 devices of every population: by kind, population, state, quantity and what it is the truth of.

    Readings are linear in what is drawn of a device (least squares over all populations of a kind) but for a rest,
    which is drawn again from those seen.
    """
    out = {}
    rng = np.random.default_rng(seed)
    for kind, state in dict.fromkeys((line["kind"], state) for line in lines for state in line["states"]):
        own = [line for line in lines if line["kind"] == kind and state in line["states"]]
        drawn = np.concatenate([line["drawn"] for line in own])
        many = [draw(kind, level_of(kind, line["seed"])[0], rng, 4000) for line in own]
        truths = [(q, "truth") for q in (*SHOWN[LOW], *SHOWN[HIGH])]
        truths += [(q, "at any speed") for q in own[0]["states"][state].get("at any speed", ())]
        for q, word in truths:
            read = np.log(np.concatenate([line["states"][state][word][q] for line in own]))
            slope, *_ = np.linalg.lstsq(np.column_stack([np.ones(read.size), drawn]), read, rcond=None)
            rest = read - slope[0] - drawn @ slope[1:]
            rest *= np.sqrt(read.size / (read.size - slope.size))
            for line, new in zip(own, many, strict=True):
                out[kind, line["seed"], state, q, word] = np.exp(
                    slope[0] + new @ slope[1:] + rng.choice(rest, new.shape[0])
                )
    return out


def truth_of(name: str, devices: Mapping[tuple[str, int, str, str, str], FloatArray], cell: Cell) -> FloatArray:
    """Draw what a limit is held against: devices, or the sum or the largest of deliveries of so many of them."""
    kind, _, q = name.split("|")
    values = devices[(*cell, q, "at any speed" if kind.endswith("at any speed") else "truth")]
    word, _, count = kind.partition(" of ")
    if not count.isdigit():
        return values
    rng = np.random.default_rng(cell[1])
    delivered = rng.choice(values, (int(count), values.size))
    return np.asarray(next(take for w, _, take in MANY if w == word)(delivered, axis=0))


def campaigns(line: Line, n_tested: int, n: int, seed: int) -> Iterator[tuple[str, dict[str, tuple[float, float]]]]:
    """Draw campaigns from a population: state of the diagnosis, and of every limit its value and the share beyond."""
    rng = np.random.default_rng([seed, line["seed"], list(KINDS).index(line["kind"]), n_tested])
    for _ in range(n):
        order = rng.permutation(len(line["drawn"]))
        chosen, new = order[:n_tested].tolist(), order[n_tested:]
        for state, measured in line["states"].items():
            out = {}
            for name, value in limits(measured, chosen).items():
                kind, side, q = name.split("|")
                beyond = math.nan  # of a delivery: drawn from many devices, not from those left
                if not kind.rpartition(" ")[2].isdigit():
                    values = np.array(measured["at any speed" if kind.endswith("any speed") else "truth"][q])[new]
                    beyond = float(np.mean(values < value if side == LOW else values > value))
                out[name] = value, beyond
            yield state, out


def report(lines: list[Line], n_tested: int, n: int, seed: int) -> str:
    """Tables of the share of new devices beyond each limit, per cent, by kind and by what the diagnosis found."""
    devices = devices_of(lines, seed)
    truths: dict[tuple[str, Cell], FloatArray] = {}
    share: dict[str, dict[Cell, list[float]]] = defaultdict(lambda: defaultdict(list))
    over: dict[str, dict[Cell, list[float]]] = defaultdict(lambda: defaultdict(list))
    values: dict[str, dict[Cell, list[float]]] = defaultdict(lambda: defaultdict(list))
    for line in lines:
        populations = sum(one["kind"] == line["kind"] for one in lines)
        for state, found in campaigns(line, n_tested, -(-n // populations), seed):
            cell = line["kind"], line["seed"], state
            for name, (value, beyond) in found.items():
                _, side, _ = name.split("|")
                if (name, cell) not in truths:
                    truths[name, cell] = truth_of(name, devices, cell)
                drawn = truths[name, cell]
                end = float(np.quantile(drawn, 0.05 if side == LOW else 0.95))
                of_drawn = float(np.mean(drawn < value if side == LOW else drawn > value))
                held = value <= end if side == LOW else value >= end
                share[name][cell].append(float(held) if "95/95" in name else of_drawn if math.isnan(beyond) else beyond)
                over[name][cell].append(value / end)
                values[name][cell].append(value)
    kinds = [kind for kind in KINDS if any(line["kind"] == kind for line in lines)]
    text = [f"\n## {n_tested} tested devices\n"]
    for state, said in STATES.items():
        if not any(cell[2] == state for cell in share[next(iter(share))]):
            continue
        cells_of = {cell: len(v) for cell, v in share[next(iter(share))].items() if cell[2] == state}
        text.append(
            f"\n### {said}\n\n{sum(cells_of.values())} campaigns from {len(cells_of)} populations.\n\n"
            f"| limit | side | quantity | {' | '.join(kinds)} | all | limit / truth |\n"
            f"|---|---|---|{'---|' * (len(kinds) + 2)}"
        )
        for name, cells in share.items():
            own = {cell: 100.0 * float(np.mean(v)) for cell, v in cells.items() if cell[2] == state}
            if not own:
                continue
            by_kind = [np.mean([v for cell, v in own.items() if cell[0] == kind] or [np.nan]) for kind in kinds]
            everything = np.array(list(own.values()))
            error = 1.96 * float(everything.std(ddof=1)) / np.sqrt(everything.size)
            wide = np.median(np.concatenate([v for cell, v in over[name].items() if cell[2] == state]))
            columns = [f"{x:.1f}" if np.isfinite(x) else "" for x in by_kind]
            text.append(
                f"| {name.replace('|', ' | ')}{' (held)' if '95/95' in name else ''} | {' | '.join(columns)} | "
                f"**{everything.mean():.1f}** ± {error:.1f} | {wide:.2f} |"
            )
    text.append(f"\n### Less safe than the law alone, per cent of the force\n\n{_against_alone(values)}")
    return "\n".join(text) + "\n"


def _against_alone(values: dict[str, dict[Cell, list[float]]]) -> str:
    """How much less safe a limit is with a diagnosis than without: campaigns by more than 2 %, and the most."""
    text = [
        "| limit | side | quantity | rightly: campaigns | most | wrongly: campaigns | most |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, cells in values.items():
        if "95/95" in name or not any(cell[2] == "rightly" for cell in cells):
            continue
        sign = 1.0 if "|low|" in name else -1.0
        row = []
        for state in ("rightly", "wrongly"):
            gap = [
                100.0 * sign * (np.array(v) / np.array(cells[cell[0], cell[1], "not"]) - 1.0)
                for cell, v in cells.items()
                if cell[2] == state
            ]
            if not gap:
                return "No population was fitted.\n"
            less = np.concatenate(gap)
            row += [f"{100.0 * float(np.mean(less > 2.0)):.1f} %", f"{float(less.max()):.1f}"]
        text.append(f"| {name.replace('|', ' | ')} | {' | '.join(row)} |")
    return "\n".join(text)


def main() -> None:
    """Simulate populations, draw campaigns from them, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-n", type=int, default=200, help="campaigns of each kind and number of tested devices (200)")
    parser.add_argument("--populations", type=int, default=4, help="populations of each kind (4)")
    parser.add_argument("--fitted", type=int, default=1, help="of these, populations whose devices are fitted (1)")
    parser.add_argument("--devices", type=int, nargs="+", default=[3, 6], help="tested devices (3 6)")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--bank", type=Path, default=Path("reports/margins-truth.jsonl"))
    parser.add_argument("--out", type=Path, default=Path("reports/margins-truth.md"))
    arguments = parser.parse_args()
    lines = [json.loads(t) for t in arguments.bank.read_text().splitlines()] if arguments.bank.exists() else []
    done = {(line["kind"], line["seed"]) for line in lines}
    n = arguments.fitted
    for c in (*range(n, n + 1), *range(n), *range(n + 1, arguments.populations)):  # a little of each kind first
        for kind in arguments.kinds:
            seed = arguments.seed + c
            if (kind, seed) not in done:
                start = time.process_time()
                lines.append(population(kind, seed, fitted=c < n))
                with arguments.bank.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(lines[-1]) + "\n")
                print(f"{kind}, {seed}: {time.process_time() - start:.0f} s", flush=True)
    tables = "".join(report(lines, n, arguments.n, arguments.seed) for n in arguments.devices)
    page = f"# New devices beyond each limit, per cent\n\n{WORDS.format(asked=' '.join(sys.argv[1:]))}\n{tables}"
    arguments.out.write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
