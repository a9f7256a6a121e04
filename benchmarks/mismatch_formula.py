"""Formulas of what the catalogue lacks: right ones found, and none in noise or where no shape of the list holds.

Run as ``python benchmarks/mismatch.py formula -n 10 --seed 9600``. The shapes are drawn for each seed; they are added
to devices of the published range (Table 1, 5 Hz, AR(1) noise of 1 kN), the base law is fitted, and its residual goes to
the search for a formula as the residual of an ``unknown`` does. In the lines of noise the residual is noise alone.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np
from mismatch import Shape, ar1, simulate

from shj_bayes.inference.run import runs_of
from shj_bayes.mismatch.calibrate import strongest_line
from shj_bayes.mismatch.diagnosis import N_QUICK
from shj_bayes.mismatch.evidence import Evidence, evidence_of
from shj_bayes.mismatch.formula import Formula, find_formula
from shj_bayes.mismatch.refit import Refit, linearise, refit
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.recording import Recording

NOISES = {"white noise": 0.0, "AR(1) noise, phi 0.9": 0.9}
NEAR_MM = 3.0  # how near to the truth an edge must be
Answer = Callable[[Formula], bool]


def shapes(seed: int) -> dict[str, tuple[Shape, Answer]]:
    """Shapes of one seed, as a share of Fy, and what makes a formula the right one."""
    rng = np.random.default_rng(seed + 1_000_000)
    pitch, phase = float(np.exp(rng.uniform(np.log(12), np.log(45)))), float(rng.uniform(0, 2 * np.pi))
    edge, centre = float(rng.uniform(-40, 40)), float(rng.uniform(-45, 45))
    width, period = float(rng.uniform(6, 12)), float(np.exp(rng.uniform(np.log(15), np.log(90))))
    half, decay = float(rng.uniform(12, 30)), float(rng.uniform(0.6, 2.0))
    return {
        "wave over position": (
            lambda h: 0.08 * h.direction * np.sin(2 * np.pi * h.position_mm / pitch + phase),
            partial(_is, name="sine", length=pitch, near=0.03 * pitch),
        ),
        "wave over slip": (
            lambda h: 0.06 * h.direction * np.sin(2 * np.pi * h.slip_mm / pitch),
            partial(_is, name="sine", coordinate="slip since reversal", length=pitch, near=0.03 * pitch),
        ),
        "wave over time": (
            lambda h: 0.08 * np.sin(2 * np.pi * h.time_s / period + phase),
            partial(_is, name="sine", coordinate="time", mode="force", length=period, near=0.03 * period),
        ),
        "step over position": (
            lambda h: 0.08 * h.direction * np.heaviside(h.position_mm - edge, 0.5),
            partial(_is, name="step", length=edge, near=NEAR_MM),
        ),
        "line over position": (
            lambda h: 0.08 * h.direction * h.position_mm / 95,
            partial(_is, name="line"),
        ),
        "parabola over position": (
            lambda h: 0.12 * h.direction * ((h.position_mm - 95) / 95) ** 2,
            partial(_is, name="parabola"),
        ),
        # As friction, the speed term of the base law would take up half of it; so it still moves the corner by 10 mm.
        "V over position": (
            lambda h: 0.1 * np.abs(h.position_mm - edge) / 95,
            partial(_is, name="modulus", mode="force", length=edge, near=4 * NEAR_MM),
        ),
        "decay with travel": (
            lambda h: 0.1 * np.exp(-h.travel_m / decay),
            partial(_is, name="exponential", coordinate="travel", mode="force", length=decay, near=0.3 * decay),
        ),
        "level in push": (lambda h: 0.1 * np.maximum(h.direction, 0.0), lambda f: _named(f) == "constant"),
        "patch, push only": (
            lambda h: 0.12 * np.maximum(h.direction, 0.0) * np.heaviside(half - np.abs(h.position_mm - edge), 0.5),
            lambda f: f.text is None,
        ),
        "bump over position": (
            lambda h: 0.12 * h.direction * np.exp(-(((h.position_mm - centre) / width) ** 2)),
            lambda f: f.text is None,
        ),
    }


def _named(formula: Formula) -> str | None:
    return formula.fitted.shape.name if formula.text is not None and formula.fitted is not None else None


def _is(
    formula: Formula,
    name: str,
    coordinate: str = "position",
    mode: str = "friction",
    length: float = 0.0,
    near: float = np.inf,
) -> bool:
    """Whether a formula has the right shape, over the right coordinate, in the right direction, at the right place."""
    if _named(formula) != name or formula.fitted is None:
        return False
    where = (formula.coordinate, formula.fitted.mode) == (coordinate, mode)
    return where and abs(formula.fitted.length * formula.scale - length) < near


def formulas(pool: Executor, n: int, first_seed: int, only: str | None) -> None:
    """Print the formula of every trial, then right formulas per shape and formulas found in noise."""
    names = [name for name in (*shapes(first_seed), *NOISES) if only in (None, name)]
    pairs = [(seed, name) for seed in range(first_seed, first_seed + n) for name in names]
    right = dict.fromkeys(names, 0)
    for (seed, name), (good, words) in zip(pairs, pool.map(_trial, *zip(*pairs, strict=True)), strict=True):
        right[name] += good
        print(f"{seed} {name}: {'right' if good else 'WRONG'}, {words}", flush=True)
    for name in names:
        print(f"{name:24}{right[name]} of {n} {'without a formula' if name in NOISES else 'right'}")


def _trial(seed: int, name: str) -> tuple[bool, str]:
    if name in NOISES:
        text = noise_trial(NOISES[name], seed)
        return text == "none", text
    return shape_trial(name, seed)


def shape_trial(name: str, seed: int) -> tuple[bool, str]:
    """Whether the formula of one device is the right one, and the formula."""
    shape, answer = shapes(seed)[name]
    evidence = _evidence(simulate({}, seed, shape=shape))
    base = _fit(evidence)
    line = strongest_line(evidence, base)
    formula = find_formula(evidence, base.residual_kN, line)
    return answer(formula), formula.text or formula.words


def noise_trial(phi: float, seed: int) -> str:
    """Look for a formula in a residual that is noise alone, with correlation `phi` from sample to sample."""
    evidence = _evidence(simulate({}, seed))
    n = evidence.force_kN.size
    residual = ar1(phi, n, np.random.default_rng(seed)) * evidence.weight
    model = DeviceModel(len(evidence.histories), read_priors("afc"))
    fit = replace(linearise(evidence, model, np.zeros(model.n_law)), residual_kN=residual)
    return find_formula(evidence, residual, strongest_line(evidence, fit)).text or "none"


def _fit(evidence: Evidence) -> Refit:
    """Fit the base law from a sharp and a rounded start."""
    model = DeviceModel(len(evidence.histories), read_priors("afc"))
    level = float(np.percentile(np.abs(evidence.force_kN[evidence.run == 1]), 90))
    starts = []
    for beta in (10.0, 100.0):
        values = {"K": 15.0, "Fy": level, "beta": beta, "gamma": 0.0, "ratio": 0.8}
        pairs = zip(model.law_names, model.laws_of_parameters, strict=False)
        starts.append(np.array([float(prior.to_free(np.asarray(values[name]))) for name, prior in pairs]))
    return refit(evidence, model, starts)


def _evidence(recordings: list[Recording]) -> Evidence:
    return evidence_of(runs_of(recordings), N_QUICK)
