"""The diagnosis: find what the force depends on, show the curve, name the physics, model it."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import one_blas_thread
from shj_bayes._util.files import replacing
from shj_bayes.inference.run import Run
from shj_bayes.inference.store import versions
from shj_bayes.mismatch import content
from shj_bayes.mismatch.classes import classes
from shj_bayes.mismatch.data import ErrorModel, data_of
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.heldout import Proven, proven
from shj_bayes.mismatch.laplace import Laplace, find_noise, laplace, laplace_under
from shj_bayes.mismatch.regions import aliases_of, regions_of
from shj_bayes.mismatch.screen import beside_missed
from shj_bayes.mismatch.search import search
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.parameters import FloatArray
from shj_bayes.options import DiagnoseOptions
from shj_bayes.results.codec import to_json
from shj_bayes.results.diagnosis import SCHEMA, DiagnosedModel, DiagnosisRecord, Input, Sampled
from shj_bayes.results.fit import Trust
from shj_bayes.results.store import Group, write, write_netcdf

Sampling = Callable[[DeviceModel, FloatArray], tuple[Mapping[str, FloatArray], Sampled]]


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """A finished diagnosis."""

    record: DiagnosisRecord
    channels: Mapping[str, FloatArray]  # content of ``diagnosis.nc``: measured and modelled force, before and after

    def write(self, folder: Path) -> None:
        """Write both files, the JSON last."""
        folder.mkdir(parents=True, exist_ok=True)
        whole = Group({name: (("sample",), values, {}) for name, values in self.channels.items()}, {"schema": SCHEMA})
        with replacing(folder / "diagnosis.nc") as part:
            write_netcdf(part, {"": whole})
        (folder / "diagnosis.html").unlink(missing_ok=True)  # of the one before; no clock tells which came first
        write(self.record, folder)

    @property
    def content(self) -> dict[str, Any]:
        """Content of ``diagnosis.json``, as plain values."""
        return dict(to_json(self.record))


@one_blas_thread
def diagnose(
    runs: Sequence[Run],
    device: DeviceModel,
    look: DiagnoseOptions | None = None,
    *,
    seed: int = 1,
    sample: Sampling | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> DiagnosisResult:
    """Find what a model leaves out of the recordings of one device.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    device : DeviceModel
        Where the search begins: the base law, with the effects that are known to be there, if any.
    look : DiagnoseOptions, optional
        What is not to be looked for, and how thoroughly; by default everything, in full.
    seed : int
        Same seed and recordings, same numbers.
    sample : callable, optional
        ``sample(model, top)`` fits the model that was found, from the most probable law parameters, and gives the draws
        by parameter and the verdict on them; without it, and in a first look, a Gaussian stands for the posterior.
    tell : callable
        Gets one line for each step.
    """
    begin = time.perf_counter()
    look = look or DiagnoseOptions()
    device = replace(device, speed="velocity" not in look.without)
    effects_named(look.without)
    hidden = look.hidden(device)
    data = data_of(runs, device)
    out = search(data, classes(hidden, data.measured), hidden, tell)
    tell("weighing what was found")
    shown = proven(out, tell)
    out, answer = shown.out, shown.answer
    models = _models(shown, seed)
    if sample is None or look.quick:
        draws: content.Draws = models.draws_after
        how = Sampled(how="Gaussian around the most probable parameters (first look)", verdict=Trust.TENTATIVE)
    else:
        tell("sampling the posterior")
        draws, how = sample(answer.shown.state.model, answer.shown.state.z)
    record = DiagnosisRecord(
        device=look.name,
        **_said(shown, models, draws),
        channels=content.further(runs),
        next_test=content.next_test(shown, quick=look.quick),
        seed=seed,
        quick=look.quick,
        sampling=how,
        model=DiagnosedModel(
            variant=device.variant,
            priors=device.priors.family,
            noise=device.noise.id,
            given=tuple(effect.id for effect in device.effects),
            without=tuple(look.without),
        ),
        inputs=tuple(Input(name=r.recording.source.name, sha256=r.recording.source.sha256) for r in runs),
        versions=versions(),
        seconds=time.perf_counter() - begin,
    )
    return DiagnosisResult(record, content.channels(shown.fine, shown.before, shown.after))


@dataclass(frozen=True, eq=False)
class _Models:
    """The base law under noise of its own, and what is known of the parameters."""

    law: Laplace  # the base law under noise of its own, all that it leaves, in the blocks of the search
    draws_before: content.Draws  # of the base law under noise of its own
    draws_after: content.Draws  # of the model that was found, beside what it leaves out: `missed`


def _models(shown: Proven, seed: int) -> _Models:
    """Fit the base law alone, and count what an answer leaves out."""
    out, answer, fine = shown.out, shown.answer, shown.fine
    base, setting = out.found[frozenset()].state, out.metric.setting
    alone = find_noise(out.data, base, np.zeros((base.residual.size, 0)), setting)
    law = laplace(out.data, ErrorModel(out.data, alone, base.slope), base.model, base.z)
    under, first = laplace_under(fine, alone, law.model, law.z)
    draws = content.draws_of(first, seed)
    if not answer.findings:
        wide = beside_missed(fine, under, first, (), tuple(out.fitter.classes.values()))
        return _Models(law, draws, content.draws_of(wide, seed))
    others = tuple(one for name, one in out.fitter.classes.items() if name not in answer.shown.key)
    sizes = [(f.member, f.size) for f in answer.findings]
    wide = beside_missed(fine, ErrorModel(fine, setting, shown.after.slope), shown.after, sizes, others)
    return _Models(law, draws, content.draws_of(wide, seed))


def _said(shown: Proven, models: _Models, draws: content.Draws) -> dict[str, Any]:
    """Give what a search found, as fields of the record."""
    out, answer, fine, both = shown.out, shown.answer, shown.fine, (shown.before, shown.after)
    noise = float(np.sqrt(np.mean(shown.after.residual[fine.used > 0] ** 2)))
    regions = regions_of(out.data, ErrorModel(out.data, out.metric.setting, models.law.slope), models.law)
    return {
        "verdict": answer.verdict,
        "reason": answer.reason.value,
        "p_value": answer.p_value,
        "coordinates": content.coordinates(out, answer),
        "sets": content.hypotheses(answer),
        "evidence": evidence_of(out, answer),
        "effects": content.effects(out, answer, draws),
        "modelled": content.modelled(answer, draws),
        "family": content.family(out, answer),
        "location": tuple(regions),
        "unknown": content.unknown(out, answer),
        "left_over_percent": 100 * answer.left_over,
        "before": content.quality(fine, shown.before, noise, shown.held[0]),
        "after": content.quality(fine, shown.after, noise, shown.held[1]),
        "heldout": content.heldout(shown),
        "shift": content.shift(models.draws_before, draws),
        "aliases": tuple(aliases_of(out.data)),
        "candidates": content.candidates(shown),
        "energy": content.energy(fine, *both),
        "fy_kN": out.data.scale_kN,
    }
