"""The diagnosis: find what the force depends on, show the curve, name the physics, model it.

What one device says of every dependence, weak or strong, is kept as log weights of sets, for sums over devices.
A search fits the sets of classes that a single device makes probable. What it leaves out as too weak may be certain in
eight devices; so every set that was fitted and is in contention is also weighed with each other class beside it, and
with each pair of them, to first order (`screen`). All stand on one scale: evidence times the prior probability.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from shj_bayes._util.arrays import FloatArray, one_blas_thread
from shj_bayes._util.files import replacing
from shj_bayes.inference.binning import Run
from shj_bayes.inference.store import versions
from shj_bayes.mismatch import content
from shj_bayes.mismatch.data import ErrorModel, data_of
from shj_bayes.mismatch.findings import Answer, curve_band
from shj_bayes.mismatch.heldout import Proven, proven
from shj_bayes.mismatch.hypothesis import LOG_PRIOR_ODDS, Candidate, Hypothesis, beside_missed, classes, unit_columns
from shj_bayes.mismatch.laplace import Laplace, find_noise, laplace, laplace_under, visible
from shj_bayes.mismatch.moves import RIVAL, Search
from shj_bayes.mismatch.regions import aliases_of, regions_of
from shj_bayes.mismatch.search import search
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.options import DiagnoseOptions
from shj_bayes.results.codec import to_json
from shj_bayes.results.diagnosis import SCHEMA, DiagnosedModel, DiagnosisRecord, EvidenceRecord, Input, Sampled
from shj_bayes.results.fit import Trust
from shj_bayes.results.store import Group, write, write_netcdf

DIGITS = 3  # of a log weight, nats
SMALLER = (1.0, 0.2, 0.04)  # of the size that fits best alone: sizes at which two candidates are weighed together
CLEAR = 0.1  # nats; less between two candidates is nothing
APART = 1.0 - 1e-12  # of the correlation of two candidates: those that do the same stay apart by more than rounding
Sampling = Callable[[DeviceModel, FloatArray], tuple[Mapping[str, FloatArray], Sampled]]


def evidence_of(out: Search, answer: Answer) -> EvidenceRecord:
    """Log weights of sets of classes, and how each class would be written in the model of the device."""
    names = sorted(out.fitter.classes)
    position = {name: i for i, name in enumerate(names)}
    fitted = {h.key: h.log_weight for h in out.found.values()}
    added: dict[frozenset[str], float] = {}
    height = out.best.log_weight
    for h in out.found.values():
        if h.log_weight > height - RIVAL:
            for key, gain in _gains_beside(out, h).items():
                weight = h.log_weight + len(key) * LOG_PRIOR_ODDS + gain
                if weight > added.get(h.key | key, -np.inf):
                    added[h.key | key] = weight
    rows = fitted | {key: weight for key, weight in added.items() if key not in fitted}
    own = {f.member.of.id: f.member.variant.effect.id for f in answer.findings}
    sizes = {f.member.of.id: f.size for f in answer.findings}
    bands = {f.member.of.id: curve_band(out, f, 2) for f in answer.findings}
    changes = {name: band["mean"][1] - band["mean"][0] for name, band in bands.items() if band is not None}
    # The model that is shown may hold classes of a size that does not matter, too: here they are others.
    plain = out.found.get(frozenset(own), out.found[frozenset()])
    # The best one of each class; a curve where it has one, to which a name is matched.
    others: dict[str, Candidate] = {}
    for c in out.fitter.screen(plain):
        kept = others.get(c.of.id)
        if c.of.id not in own and (kept is None or (kept.variant.curve is None and c.variant.curve is not None)):
            others[c.of.id] = c
    first = _FirstOrder(out, plain, list(others.values()))
    for i, (name, c) in enumerate(others.items()):
        mean, change = first.means[i]
        sizes[name] = float(visible(out.data, plain.state.jacobian, change[:, None])[0])
        if c.variant.curve is not None:
            ends = c.variant.curve.rows(np.array([0.0, 1.0]), np.ones(2)) @ mean
            changes[name] = 100.0 * (ends[1] - ends[0])
    return EvidenceRecord(
        classes=tuple(names),
        log_odds=LOG_PRIOR_ODDS,
        own=own,
        written={name: c.variant.effect.id for name, c in sorted(others.items())},
        size_percent={name: round(100.0 * size, DIGITS) for name, size in sizes.items()},
        change_percent={name: round(float(change), DIGITS) for name, change in changes.items()},
        sets=tuple(tuple(sorted(position[name] for name in key)) for key in rows),
        nats=tuple(round(weight - fitted[frozenset()], DIGITS) for weight in rows.values()),
        fitted=len(fitted),
    )


def _gains_beside(out: Search, h: Hypothesis) -> dict[frozenset[str], float]:
    """Log Bayes factor to first order of each class, and of each pair of classes, beside a hypothesis.

    That of a class is averaged over the ways to write it, where it begins, and its size. That of a pair is the product
    of both, times what the best way to write the one makes of the best way to write the other: far below 1 where the
    two do the same.
    """
    by_class: dict[str, list[Candidate]] = {}
    for c in out.fitter.screen(h):
        by_class.setdefault(c.of.id, []).append(c)
    alone: dict[str, float] = {}
    for name, own in by_class.items():
        starts: dict[str, list[float]] = {}
        for c in own:
            curve = c.variant.curve
            word = c.variant.effect.id if curve is None else f"{curve.coordinate} {curve.length} {curve.sides}"
            starts.setdefault(word, []).append(c.gain)
        means = [np.logaddexp.reduce(gains) - np.log(len(gains)) for gains in starts.values()]
        alone[name] = float(np.logaddexp.reduce(means))
    gains = {frozenset((name,)): gain for name, gain in alone.items()}
    first = _FirstOrder(out, h, [own[0] for own in by_class.values()])
    for (i, a), (j, b) in combinations(enumerate(by_class), 2):
        gains[frozenset((a, b))] = alone[a] + alone[b] + first.interplay(i, j)
    return gains


class _FirstOrder:
    """Candidates beside a hypothesis to first order, each of the size that fits best.

    The coefficients of each are turned to the axes of its own products: at any size its precision is diagonal.
    """

    def __init__(self, out: Search, h: Hypothesis, candidates: Sequence[Candidate]) -> None:
        columns = [unit_columns(c) for c in candidates]
        beside = out.metric.gaussian(h.state.beside(*columns)).given(h.state.z.size)
        ends = np.cumsum([0, *(c.shape[1] for c in columns)])
        self._places = [np.arange(a, b) for a, b in pairwise(ends)]
        axes = [np.linalg.eigh(beside.inner[np.ix_(own, own)]) for own in self._places]
        turned = block_diag(np.zeros((0, 0)), *(vectors for _, vectors in axes))
        self._inner, self._along = turned.T @ beside.inner @ turned, turned.T @ beside.along
        # Posterior mean of the coefficients of each alone, and what it does to the force, kN.
        means = (v @ (self._along[own] / (1.0 + d)) for own, (d, v) in zip(self._places, axes, strict=True))
        self.means = [(mean, c @ mean) for mean, c in zip(means, columns, strict=True)]

    def interplay(self, i: int, j: int) -> float:
        """Log Bayes factor of two candidates over the product of theirs; 0 where neither does what the other does."""
        extra, one, other = self._together(i, j, np.ones((1, 2)))
        if abs(extra[0]) < CLEAR:
            return float(extra[0])
        # The size that fits a candidate alone need not fit it beside the other.
        extra, one, other = self._together(i, j, np.array(list(product(SMALLER, repeat=2))))
        n = len(SMALLER)
        alone = np.logaddexp.reduce(one[::n]) + np.logaddexp.reduce(other[:n])
        return float(np.logaddexp.reduce(extra + one + other) - alone)

    def _together(self, i: int, j: int, sizes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log Bayes factors of two candidates of m pairs of sizes, shape (m, 2): both over the product, and each."""
        (a, fits_a, one), (b, fits_b, other) = (self._alone(k, own) for k, own in ((i, sizes[:, 0]), (j, sizes[:, 1])))
        shared = APART * a[:, :, None] * self._inner[np.ix_(self._places[i], self._places[j])] * b[:, None, :]
        if shared.shape[1] > shared.shape[2]:
            shared, fits_a, fits_b = np.swapaxes(shared, 1, 2), fits_b, fits_a
        root = np.linalg.cholesky(np.eye(shared.shape[1]) - shared @ np.swapaxes(shared, 1, 2))
        left = np.linalg.solve(root, (fits_a - np.einsum("mij,mj->mi", shared, fits_b))[:, :, None])[:, :, 0]
        half_log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        return 0.5 * ((left**2).sum(axis=1) - (fits_a**2).sum(axis=1)) - half_log_det, one, other

    def _alone(self, i: int, sizes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Roots of the sized covariance of one candidate, its data in units of their errors, and its log factors."""
        own = self._places[i]
        precision = 1.0 + sizes[:, None] ** 2 * np.maximum(np.diagonal(self._inner)[own], 0.0)
        root = sizes[:, None] / np.sqrt(precision)
        fits = root * self._along[own]
        return root, fits, 0.5 * (fits**2 - np.log(precision)).sum(axis=1)


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
    out = search(data, classes(hidden, data.blocks[0].history.measured), hidden, tell)
    tell("weighing what was found")
    shown = proven(out, tell)
    out, answer = shown.out, shown.answer
    law, before, after = _models(shown, seed)
    if sample is None or look.quick:
        draws: content.Draws = after
        how = Sampled(how="Gaussian around the most probable parameters (first look)", verdict=Trust.TENTATIVE)
    else:
        tell("sampling the posterior")
        draws, how = sample(answer.shown.state.model, answer.shown.state.z)
    record = DiagnosisRecord(
        device=look.name,
        **_said(shown, law, before, draws),
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


def _models(shown: Proven, seed: int) -> tuple[Laplace, content.Draws, content.Draws]:
    """Fit the base law under noise of its own, all that it leaves, in the blocks of the search.

    Behind it draws of its parameters, and of those of the model that was found, beside what it leaves out (`missed`).
    """
    out, answer, fine = shown.out, shown.answer, shown.fine
    base, setting = out.found[frozenset()].state, out.metric.setting
    alone = find_noise(out.data, base, np.zeros((base.residual.size, 0)), setting)
    law = laplace(ErrorModel(out.data, alone, base.slope), base.model, base.z)
    under, first = laplace_under(fine, alone, law.model, law.z)
    draws = content.draws_of(first, seed)
    if not answer.findings:
        wide = beside_missed(under, first, (), tuple(out.fitter.classes.values()))
        return law, draws, content.draws_of(wide, seed)
    others = tuple(one for name, one in out.fitter.classes.items() if name not in answer.shown.key)
    sizes = [(f.member, f.size) for f in answer.findings]
    wide = beside_missed(ErrorModel(fine, setting, shown.after.slope), shown.after, sizes, others)
    return law, draws, content.draws_of(wide, seed)


def _said(shown: Proven, law: Laplace, before: content.Draws, draws: content.Draws) -> dict[str, Any]:
    """Give what a search found, as fields of the record; `law` and `before` as of `_models`."""
    out, answer, fine, both = shown.out, shown.answer, shown.fine, (shown.before, shown.after)
    noise = float(np.sqrt(np.mean(shown.after.residual[fine.blocks.used > 0] ** 2)))
    regions = regions_of(ErrorModel(out.data, out.metric.setting, law.slope), law)
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
        "shift": content.shift(before, draws),
        "aliases": tuple(aliases_of(out.data)),
        "candidates": content.candidates(shown),
        "energy": content.energy(fine, *both),
        "fy_kN": out.data.scale_kN,
    }
