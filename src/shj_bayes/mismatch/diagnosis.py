"""The diagnosis: find what the force depends on, show the curve, name the physics, model it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from shj_bayes._util.files import write_text
from shj_bayes._util.one_thread import one_blas_thread
from shj_bayes.inference.run import Run
from shj_bayes.inference.store import versions
from shj_bayes.mismatch import content
from shj_bayes.mismatch.alias import aliases_of
from shj_bayes.mismatch.classes import classes
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.findings import answer_of
from shj_bayes.mismatch.heldout import held_out
from shj_bayes.mismatch.regions import regions_of
from shj_bayes.mismatch.scene import Metric, scene_of
from shj_bayes.mismatch.schema import SCHEMA
from shj_bayes.mismatch.search import search
from shj_bayes.mismatch.state import find_noise, settle, settle_under
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.parameters import FloatArray

Sampling = Callable[[DeviceModel, FloatArray], tuple[Mapping[str, FloatArray], dict[str, Any]]]


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


@one_blas_thread
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
        A first look: no sampling of the posterior, approximate intervals.
    sample : callable, optional
        ``sample(model, top)`` fits the model that was found, from the most probable law parameters, and gives the draws
        by parameter and the verdict on them; without it, and in a first look, a Gaussian stands for the posterior.
    tell : callable
        Gets one line for each step.
    """
    begin = time.perf_counter()
    device = replace(device, speed="velocity" not in without)
    effects_named(without)
    hidden = frozenset({*(n for n in without if n != "velocity"), *(e.mechanism for e in device.effects)})
    if "velocity" not in without:
        hidden |= {"velocity"}
    scene = scene_of(runs, device)
    out = search(scene, classes(hidden, scene.measured), hidden, tell)
    scene = out.scene
    tell("weighing what was found")
    answer = answer_of(out)
    base, shown = out.found[frozenset()].state, answer.shown.state
    # The base law alone has noise of its own: all that it leaves.
    alone = find_noise(scene, base, np.zeros((base.residual.size, 0)), out.metric.setting)
    law = settle(scene, Metric(scene, alone, base.slope), base.model, base.z)
    fine, setting = scene.finer_at(shown.model, shown.z), out.metric.setting
    plain = settle_under(fine, setting, law.model, law.z)[1]
    drawn = [plain, settle_under(fine, setting, shown.model, shown.z)[1] if answer.findings else plain]
    before = content.draws_of(settle_under(fine, alone, law.model, law.z)[1], seed)
    if sample is None or quick:
        draws: Mapping[str, FloatArray] = content.draws_of(drawn[1], seed) if answer.findings else before
        how = {"how": "Gaussian around the most probable parameters (first look)", "verdict": "tentative"}
    else:
        tell("sampling the posterior")
        draws, how = sample(shown.model, shown.z)
    metric = Metric(fine, setting, drawn[1].slope)
    held = [held_out(fine, metric, state) for state in drawn]
    noise = float(np.sqrt(np.mean(drawn[1].residual[fine.used > 0] ** 2)))
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "device": name,
        "verdict": answer.verdict.value,
        "reason": answer.reason.value,
        "p_value": answer.p_value,
        "coordinates": content.coordinates(out, answer),
        "channels": content.further(runs),
        "sets": content.hypotheses(answer),
        "evidence": evidence_of(out, answer),
        "effects": content.effects(out, answer, draws),
        "modelled": content.modelled(answer, draws),
        "family": content.family(out, answer),
        "location": content.locations(regions_of(scene, Metric(scene, out.metric.setting, law.slope), law)),
        "unknown": content.unknown(out, answer),
        "left_over_percent": 100 * answer.left_over,
        "before": content.quality(fine, drawn[0], noise, held[0]),
        "after": content.quality(fine, drawn[1], noise, held[1]),
        "heldout": content.heldout(*held),
        "shift": content.shift(before, draws),
        "aliases": content.alias_rows(aliases_of(scene)),
        "next_test": content.next_test(out, answer, quick=quick),
        "candidates": content.candidates(out, answer),
        "energy": content.energy(fine, *drawn),
        "fy_kN": scene.scale_kN,
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
    record["seconds"] = time.perf_counter() - begin
    return Diagnosis(record, content.channels(fine, *drawn))
