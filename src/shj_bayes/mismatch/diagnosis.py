"""The diagnosis: fit, locate, name, model, and what to show; the content of ``diagnosis.json`` and ``diagnosis.nc``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from shj_bayes.errors import ModelError
from shj_bayes.files import write_text
from shj_bayes.inference.problem import Run
from shj_bayes.inference.store import versions
from shj_bayes.mismatch import content
from shj_bayes.mismatch.alias import alias_table
from shj_bayes.mismatch.evidence import Evidence, evidence_of
from shj_bayes.mismatch.intervals import Effort, approximate, sampled
from shj_bayes.mismatch.locate import largest_region
from shj_bayes.mismatch.refit import Refit, make_model, refit
from shj_bayes.mismatch.regions import regions_of
from shj_bayes.mismatch.search import Setting, search
from shj_bayes.mismatch.share import share
from shj_bayes.mismatch.thresholds import LINE, REPEAT_P
from shj_bayes.mismatch.unknown import describe_unknown
from shj_bayes.mismatch.verdict import judge
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.priors import Priors
from shj_bayes.suggest import did_you_mean

N_QUICK = 4000
N_COARSE = 2000  # starts are chosen on these
N_FINE = 24_000  # the noise floor is looked for on these


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """A finished diagnosis.

    Parameters
    ----------
    record : dict
        Content of ``diagnosis.json``.
    channels : xarray.Dataset
        Content of ``diagnosis.nc``: measured and modelled force, before and after.
    """

    record: dict[str, Any]
    channels: xr.Dataset

    def write(self, folder: Path) -> None:
        """Write both files, the JSON last."""
        folder.mkdir(parents=True, exist_ok=True)
        part = folder / "diagnosis.nc.part"
        self.channels.to_netcdf(part, engine="h5netcdf")
        part.replace(folder / "diagnosis.nc")
        write_text(folder / "diagnosis.json", json.dumps(self.record, indent=1, allow_nan=False))


def diagnose(
    runs: Sequence[Run],
    priors: Priors,
    *,
    name: str = "device",
    variant: str = "seed",
    without: Sequence[str] = (),
    seed: int = 1,
    quick: bool = False,
    effort: Effort | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find what the base law leaves out of the recordings of one device.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    priors : Priors
        Of the base parameters.
    name : str
        Name of the device.
    variant : {"seed", "continuous"}
        Reversal rule.
    without : sequence of str
        ``velocity`` runs the base law without speed dependence; any other effect id is taken out of the catalogue.
    seed : int
        Same seed and recordings, same numbers.
    quick : bool
        A first look: fewer samples, no sampling of the posterior, approximate intervals.
    effort : Effort, optional
        What to spend on sampling the posterior; None for a jackknife over cycles alone in a quick look.
    tell : callable
        Gets one line for each step.

    Returns
    -------
    Diagnosis
    """
    begin = time.perf_counter()
    effects = _catalogue(without)
    speed = "velocity" not in without
    evidence = evidence_of(runs, N_QUICK) if quick else evidence_of(runs)
    tell("comparing what the displacement history can tell apart")
    aliases = alias_table(evidence, priors, tuple(catalogue().values()), variant)
    tell("fitting the base law")
    base = _fit_base(evidence, priors, variant, speed)
    regions = regions_of(evidence)
    coarse, fine = evidence_of(runs, N_COARSE), evidence_of(runs, N_FINE)
    setting = Setting(evidence, coarse, fine, regions, priors, effects, variant, seed, tell)
    result = search(setting, base)
    last = result.steps[-1]
    left, _ = largest_region(evidence, result.known, regions, last.alarm)
    if last.line.p_value < LINE:
        left = max(left, last.line.amplitude_kN)
    if last.repeat.p_value < REPEAT_P:
        left = max(left, last.repeat.size_kN)
    noise = result.final.rmse_kN
    judgement = judge(result, left, share(evidence, fine, base, base, result.known))
    shown = result.final if result.found else base
    if quick and effort is None:
        draws, how = approximate(evidence, shown, seed)
    else:
        tell("sampling the posterior")
        draws, how = sampled(runs, evidence, shown, priors, seed=seed, effort=effort or Effort())
    record = {
        "schema": content.SCHEMA,
        "device": name,
        "verdict": judgement.word,
        "reason": judgement.reason,
        "p_value": result.steps[0].p_value,
        "effects": content.effects(evidence, result, judgement, draws),
        "family": content.family(result, judgement),
        "location": content.locations(evidence, base, regions, result, noise),
        "unknown": describe_unknown(evidence, result, regions, seed=seed, quick=quick)
        if judgement.word == "unknown"
        else None,
        "before": content.quality(evidence, base, noise),
        "after": content.quality(evidence, shown, noise),
        "heldout": content.heldout(evidence, result, shown),
        "shift": content.shift(evidence, base, shown, draws),
        "aliases": [{"pair": list(a.pair), "correlation": a.correlation} for a in aliases],
        "next_test": content.next_test(result, judgement),
        "candidates": content.candidates(result),
        "energy": content.energy(evidence, base, shown),
        "fy_kN": base.capacity_kN,
        "seed": seed,
        "quick": quick,
        "sampling": how,
        "model": {"variant": variant, "priors": priors.family, "without": list(without)},
        "inputs": [{"name": r.recording.source.name, "sha256": r.recording.source.sha256} for r in runs],
        "versions": versions(),
    }
    record["words"] = content.words(record)
    record["seconds"] = time.perf_counter() - begin
    return Diagnosis(record, content.channels(evidence, base, shown))


def _catalogue(without: Sequence[str]) -> tuple[Effect, ...]:
    """Effects to try: all, less those taken out; ``velocity`` only where the base law runs without it."""
    known = catalogue()
    for name in without:
        if name not in known:
            words = f"{', '.join(known)}{did_you_mean(name, known)}"
            raise ModelError(f"--without {name}: not an effect; known are {words}")
    hidden = {name for name in without if name != "velocity"}
    if "velocity" not in without:
        hidden.add("velocity")
    return tuple(effect for effect in known.values() if effect.id not in hidden)


def _fit_base(evidence: Evidence, priors: Priors, variant: str, speed: bool) -> Refit:
    """Fit the base law from a grid of starts."""
    model = make_model(priors, len(evidence.histories), (), variant=variant, speed=speed)
    force = np.abs(evidence.force_kN)
    run = evidence.run
    peaks = [float(np.percentile(force[run == h.run], 90)) for h in evidence.histories]
    half = evidence.histories[0].half_stroke_mm
    starts = []
    for knee in (5.0, 15.0, 50.0):
        for beta in (6.0, 60.0):
            for level in (0.7, 1.0):
                values = {"K": knee * peaks[0] / half / 2, "Fy": level * peaks[0], "beta": beta, "gamma": 0.0}
                values |= {n: peaks[int(n.partition("_")[2] or 2) - 1] / peaks[0] for n in model.names if "ratio" in n}
                starts.append(
                    np.array(
                        [
                            float(p.to_free(np.asarray(values[n])))
                            for n, p in zip(model.names, model.priors, strict=True)
                        ]
                    )
                )
    return refit(evidence, model, starts)
