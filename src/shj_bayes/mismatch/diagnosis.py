"""The diagnosis: fit, locate, name, model, and what to show; the content of ``diagnosis.json`` and ``diagnosis.nc``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import xarray as xr

from shj_bayes.files import write_text
from shj_bayes.inference.fit import first_look
from shj_bayes.inference.posterior import make_posterior
from shj_bayes.inference.run import Run
from shj_bayes.inference.start import law_starts
from shj_bayes.inference.store import versions
from shj_bayes.mismatch import content
from shj_bayes.mismatch.alias import alias_table
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.locate import largest_region
from shj_bayes.mismatch.refit import refit
from shj_bayes.mismatch.regions import regions_of
from shj_bayes.mismatch.search import Setting, search
from shj_bayes.mismatch.share import share
from shj_bayes.mismatch.thresholds import LINE, REPEAT_P
from shj_bayes.mismatch.unknown import describe_unknown
from shj_bayes.mismatch.verdict import judge
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.parameters import FloatArray

Sampling = Callable[[DeviceModel, FloatArray], tuple[Mapping[str, FloatArray], dict[str, Any]]]
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
    device: DeviceModel,
    *,
    name: str = "device",
    without: Sequence[str] = (),
    seed: int = 1,
    quick: bool = False,
    sample: Sampling | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find what a model leaves out of the recordings of one device.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    device : DeviceModel
        Where the search begins: the base law, with the effects that are known to be there, if any.
    name : str
        Name of the device.
    without : sequence of str
        ``velocity`` runs the base law without speed dependence; any other effect id is taken out of the catalogue.
    seed : int
        Same seed and recordings, same numbers.
    quick : bool
        A first look: fewer samples, no sampling of the posterior, approximate intervals.
    sample : callable, optional
        ``sample(model, top)`` fits the model that was found, from the most probable law parameters, and gives the draws
        by parameter and the verdict on them; without it, and in a first look, a Gaussian stands for the posterior.
    tell : callable
        Gets one line for each step.

    Returns
    -------
    Diagnosis
    """
    begin = time.perf_counter()
    device = replace(device, speed="velocity" not in without)
    effects = _catalogue(without, device.effects)
    evidence = evidence_of(runs, N_QUICK) if quick else evidence_of(runs)
    tell("comparing what the displacement history can tell apart")
    aliases = alias_table(evidence, device.with_effects(()), tuple(catalogue().values()))
    tell("fitting the base law")
    base = refit(evidence, device, law_starts(make_posterior(runs, device)))
    regions = regions_of(evidence)
    coarse, fine = evidence_of(runs, N_COARSE), evidence_of(runs, N_FINE)
    setting = Setting(evidence, coarse, fine, regions, effects, seed, tell)
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
    before: Mapping[str, FloatArray] = first_look(runs, base.model, tops=[base.z], seed=seed)
    if sample is None:
        after = before if shown is base else first_look(runs, shown.model, tops=[shown.z], seed=seed)
        draws: Mapping[str, FloatArray] = after
        how: dict[str, Any] = {
            "how": "Gaussian around the most probable parameters (first look)",
            "verdict": "tentative",
        }
    else:
        tell("sampling the posterior")
        draws, how = sample(shown.model, shown.z)
    record = {
        "schema": content.SCHEMA,
        "device": name,
        "verdict": judgement.word,
        "reason": judgement.reason,
        "p_value": result.steps[0].p_value,
        "effects": content.effects(evidence, result, judgement, draws),
        "family": content.family(result, judgement),
        "location": content.locations(evidence, base, regions, result, noise),
        "unknown": describe_unknown(evidence, result, regions, seed=seed) if judgement.word == "unknown" else None,
        "before": content.quality(evidence, base, noise),
        "after": content.quality(evidence, shown, noise),
        "heldout": content.heldout(evidence, result, shown),
        "shift": content.shift(before, draws),
        "aliases": [{"pair": list(a.pair), "correlation": a.correlation} for a in aliases],
        "next_test": content.next_test(result, judgement),
        "candidates": content.candidates(result),
        "energy": content.energy(evidence, base, shown),
        "fy_kN": base.capacity_kN,
        "seed": seed,
        "quick": quick,
        "sampling": how,
        "model": {
            "variant": device.variant,
            "priors": device.priors.family,
            "noise": device.noise.id,
            "given": [effect.id for effect in device.effects],
            "without": list(without),
        },
        "inputs": [{"name": r.recording.source.name, "sha256": r.recording.source.sha256} for r in runs],
        "versions": versions(),
    }
    record["words"] = content.words(record)
    record["seconds"] = time.perf_counter() - begin
    return Diagnosis(record, content.channels(evidence, base, shown))


def _catalogue(without: Sequence[str], given: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects to try: all, less those taken out or given; ``velocity`` only where the base law runs without it."""
    known = catalogue()
    effects_named(without)
    hidden = {*(name for name in without if name != "velocity"), *(effect.id for effect in given)}
    if "velocity" not in without:
        hidden.add("velocity")
    return tuple(effect for effect in known.values() if effect.id not in hidden)
