"""What is known of devices before the next test: what each may be, and how many more are needed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri, logsumexp, nctdtrit, ndtri

from shj_bayes._util.arrays import BoolArray, FloatArray, one_blas_thread
from shj_bayes._util.files import damage_told
from shj_bayes.errors import PlanError, did_you_mean
from shj_bayes.inference.binning import BinnedRun, Blocks, Run, reduce_runs
from shj_bayes.inference.gaussian import Gaussian
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.mismatch.data import (
    COARSER,
    MODEL_ERROR,
    N_OF_DEVICE,
    N_OF_RUN,
    BinnedData,
    ErrorModel,
    ErrorParameters,
    data_of,
)
from shj_bayes.mismatch.findings import most_probable
from shj_bayes.mismatch.fitter import Fitter, noise_beside, noise_of_size
from shj_bayes.mismatch.hypothesis import (
    ALPHA,
    CONSTANT,
    CURVES,
    LOG_PRIOR_ODDS,
    MIN_EFFECT,
    PRIOR_INCLUSION,
    TYPICAL,
    Candidate,
    Hypothesis,
    candidates,
    classes,
)
from shj_bayes.mismatch.laplace import find_noise, laplace
from shj_bayes.model.curve import SIZES, Curve
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.model.history import SCALES, History, coordinate_of, histories
from shj_bayes.model.parameters import base_and_run, run_name
from shj_bayes.options import DiagnoseOptions
from shj_bayes.planning.protocol import Protocol, Rig
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.recording import Column, Recording, Source
from shj_bayes.results.device import DeviceResult
from shj_bayes.results.diagnosis import DependenceId, DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import has

ODDS_IN_FILES = 1e-6  # probabilities below it are left out


def read_device(folder: Path, diagnosis: DiagnosisRecord | None) -> DeviceUnderTest:
    """Read a device from the files of its fit and of its diagnosis; a fit without one is taken for what it is.

    `PlanError` if there is no fit, or the diagnosis states no probabilities.
    """
    if diagnosis is not None and not has(FitRecord, folder):
        raise PlanError(
            f"{folder.name} holds a first look and no fit, so the recordings are not there; run shj-bayes fit with "
            "them and the same -o, or shj-bayes diagnose without --quick"
        )
    with damage_told(f"fit.json or posterior.nc in {folder.name}", PlanError):
        fit = DeviceResult.read(folder)
        channels = {name: fit.by_run(fit.samples[name]) for name in ("time_s", "used", *fit.record.channels)}
        runs = []
        for i, (entry, history) in enumerate(zip(fit.record.inputs, fit.histories, strict=True)):
            motion = replace(history.motion, noise_mm=entry.displacement_noise_mm)
            named = {coordinate_of(name): name for name in entry.extras}
            extras = (Column(named.get(k, k), channels[k][i], said.unit) for k, said in fit.record.channels.items())
            recording = Recording(
                channels["time_s"][i],
                motion.displacement_mm,
                fit.measured_kN[i],
                channels["used"][i] > 0,
                Source(entry.name, str(entry.sha256), entry.format),
                extras=tuple(extras),
            )
            runs.append(Run(recording, motion))
        logs, model = np.log(fit.draws["Fy"]), fit.model
    without: tuple[str, ...] = ()
    sets: tuple[tuple[Key, float], ...] = ((frozenset(), 1.0),)
    if diagnosis is not None:
        given, without = (said.given, said.without) if (said := diagnosis.model) else ((), ())
        model = replace(model, effects=effects_named(given), speed=model.speed and "velocity" not in without)
        sets = tuple((frozenset(row.classes), row.probability) for row in diagnosis.sets)
        sets = tuple(pair for pair in sets if pair[1] > ODDS_IN_FILES)
        if not sets:
            raise PlanError(f"diagnosis.json in {folder.name} states no probabilities; run shj-bayes diagnose again")
    Fy = float(np.exp(logs.mean())), float(logs.std(ddof=1))
    return DeviceUnderTest(fit.record.device, tuple(runs), model, sets, DiagnoseOptions(without).hidden(model), Fy=Fy)


FRACTILE = 0.05
WITHIN = 0.05  # of the force: half of the 90 % interval
ASSURANCE = 0.8
MOST = 500


@dataclass(frozen=True)
class Further:
    """Devices needed."""

    n_tested: int  # devices tested so far
    force_kN: float  # estimate of the force that 95 % of devices exceed
    spread: float  # standard deviation of the logarithm of the force between devices
    half_width_now: float  # half of the 90 % interval of that force now, as a share of it
    n_further: int | None  # further devices; None where more than `MOST` would be needed
    # by number of further devices, half the width of what is then known: expected, and kept with `ASSURANCE`
    table: tuple[Mapping[str, float], ...]


def further_devices(forces_kN: Sequence[float], errors: Sequence[float]) -> Further:
    """Plan further devices for a lognormal population; `PlanError` for fewer than two: one says nothing of the spread.

    The half width of the interval of a fractile is that of the noncentral t distribution (Owen 1963, factors for
    tolerance limits) times the spread; what the spread will turn out to be has the chi-square law of the devices tested
    so far. `errors` are standard deviations of the logarithm with which each force is known.
    """
    n = len(forces_kN)
    if n < 2:
        raise PlanError(
            f"{n} device given; --question force needs the folders of two or more devices of a set: one says nothing "
            "of how much devices differ"
        )
    logs = np.log(np.asarray(forces_kN, dtype=np.float64))
    spread = max(float(logs.std(ddof=1)), float(np.sqrt(np.mean(np.square(errors)))), 1e-4)
    widths = half_width(n + np.arange(MOST + 1)) * spread
    expected, assured = (widths * math.sqrt((n - 1) / float(chdtri(n - 1, q))) for q in (0.5, ASSURANCE))
    enough = 1 + np.flatnonzero(assured[1:] <= WITHIN)
    needed = int(enough[0]) if enough.size else None
    told = sorted({1, 2, 3, 5, 8, 12, 20, 35, 60, 100} | ({needed} if needed else set()))
    rows = (
        {"n_further": k, "half_width_expected": float(expected[k]), "half_width_assured": float(assured[k])}
        for k in told
        if k <= 2 * (needed or MOST) + 1
    )
    force, now = math.exp(float(logs.mean()) + float(ndtri(FRACTILE)) * spread), float(widths[0])
    return Further(n, force, spread, now, 0 if now <= WITHIN and n > 2 else needed, tuple(rows))


def half_width(n: ArrayLike) -> FloatArray:
    """Half of the 90 % interval of the 5 % fractile of a normal sample, in standard deviations of the sample."""
    n = np.asarray(n, dtype=np.float64)
    low, high = (nctdtrit(n - 1, -float(ndtri(FRACTILE)) * np.sqrt(n), q) for q in (0.05, 0.95))
    return np.asarray((high - low) / (2.0 * np.sqrt(n)))


MOST_RUNS = 9
KINDS = 3  # ways to write a class, by smoothness or as an effect, that are fitted
NEAR = 7.0  # nats behind the best way, beyond which a way is left out
MOST_RIVALS, LEAST_SHARE = 12, 1e-4  # of the most probable
SMOOTHNESS = 0.5  # length of a curve that no test has been seen of, as a share of the range
PLANNED = Source("planned")
Key = frozenset[str]


@dataclass(frozen=True, eq=False)
class DeviceUnderTest:
    """A tested device that a further test is planned for, and what it may be."""

    name: str
    runs: tuple[Run, ...]  # its tests
    device: DeviceModel  # base model, with the effects that were given to the diagnosis
    sets: tuple[tuple[Key, float], ...]  # what it may hold, with probabilities
    hidden: frozenset[str]  # mechanisms that are not looked for
    # whether the probabilities are those before any test, so that what the runs say of them is still to be weighed
    untold: bool = False
    Fy: tuple[float, float] = (math.nan, math.nan)  # sliding force, kN, and the standard deviation of its logarithm


@dataclass(frozen=True, eq=False)
class RivalModel:
    """One thing that a device may be."""

    key: Key  # classes that it holds beyond the base law
    share: float  # its probability
    model: DeviceModel  # model of the old runs and the planned one
    z: FloatArray  # shape (n_law,): where it is linearised, unbounded
    # of d = n_law + p + 1 + n_runs coefficients: law parameters, those of the discrepancy, the load cell's zeros in the
    # planned run and in the old ones; mean, shape (d,), after the old tests, and what these say of them
    mean: FloatArray
    gaussian: Gaussian

    @property
    def drawn(self) -> BoolArray:
        """Which parameters of the law differ from what is expected: not those that no test tells of yet, (n_law,).

        Their prior is wide, and where rivals differ a straight line does not reach so far: the sliding force of a new
        run would tell them apart by itself.
        """
        of_effects = np.array(["." in name for name in self.model.law_names])
        return np.asarray(of_effects | np.any(self.gaussian.inner[: self.z.size], axis=1))


@dataclass(frozen=True, eq=False)
class PretestPosterior:
    """A device before its next test."""

    name: str
    runs: tuple[Run, ...]  # its tests so far; none where only priors are known
    device: DeviceModel  # base model of the old runs and the planned one
    z: FloatArray  # shape (n_law,): parameters of the base model, unbounded
    old: Blocks  # the old runs in blocks, on the common scales
    scales: Mapping[str, Any]  # of the coordinates; from `common_scales`
    setting: ErrorParameters  # noise and discrepancy
    rivals: tuple[RivalModel, ...]  # what the device may be, most probable first; the shares add up to 1
    middle_mm: float  # displacement of the middle of the stroke
    peak_mm_s: float | None = None  # peak speed of the old tests, which low speeds are a share of

    @property
    def shares(self) -> FloatArray:
        """Probability of each rival, shape (n_rivals,)."""
        return np.array([b.share for b in self.rivals])

    @property
    def probabilities(self) -> dict[Key, float]:
        """Probability of each set of classes, the most probable first."""
        out: dict[Key, float] = {}
        for b in self.rivals:
            out[b.key] = out.get(b.key, 0.0) + b.share
        return dict(sorted(out.items(), key=lambda one: (-one[1], sorted(one[0]))))

    @property
    def keys(self) -> tuple[Key, ...]:
        """Sets of classes that are told apart, most probable first."""
        return tuple(self.probabilities)

    @property
    def entropy(self) -> float:
        """Entropy of these probabilities, nats."""
        return float(entropy_of(np.array(list(self.probabilities.values()))))

    @property
    def contenders(self) -> tuple[Key, ...]:
        """Fewest sets that together hold 95 %, most probable first."""
        return tuple(key for key, _ in most_probable(list(self.probabilities.items())))

    def base_force(self, history: History, start_force_kN: float = 0.0, share_of_speed: float = 1.0) -> FloatArray:
        """Force of the base law in one run with a share of its dependence on speed, shape (n,), kN."""
        alone = replace(self.device, n_runs=1, effects=())
        values = self.device.law_values(self.z)
        theta = np.array([values.get(n, 1.0) * (share_of_speed if n == "gamma" else 1.0) for n in alone.names])
        return np.asarray(alone.force(theta[None], history, start_force_kN)[0])

    @property
    def sliding_kN(self) -> float:
        """Sliding force Fy."""
        return self.device.law_values(self.z)["Fy"]

    def data(self, time_s: FloatArray, motion: Motion, force_kN: FloatArray) -> BinnedData:
        """Hold the model against one further run, its blocks `COARSER` times as long as those of a fit.

        Times are from 0, the displacement is from the middle of the stroke.
        """
        run = Run(Recording(time_s, motion.displacement_mm, force_kN, source=PLANNED), motion)
        bends = partial(self.base_force, share_of_speed=0.0)  # what the speed adds is straight
        part = _zero_within(reduce_runs((run,), bends, coarser=COARSER)[0], self.keys, self.sliding_kN)
        blocks = Blocks([replace(part, history=self.placed(part.history))])
        return BinnedData(Likelihood(blocks, self.device), self.z, self.peak_mm_s)

    def placed(self, history: History) -> History:
        """History of a first run as one that follows the old ones, with their further channels at the references."""
        last = self.old[-1].history if self.old else None
        moved = 0.0 if last is None else float(last.travel_m[-1])
        turns = history.near_turns
        if turns is not None:
            rows = turns[0].copy()
            rows[5] += moved
            turns = (rows, turns[1])
        return replace(
            history,
            run=len(self.runs) + 1,
            position_mm=history.motion.displacement_mm,
            travel_m=history.travel_m + moved,
            begun_s=0.0 if last is None else last.begun_s + self.runs[-1].recording.duration_s,
            before=last,
            near_turns=turns,
            measured={} if last is None else last.held({}).measured,
            **self.scales,
        )


def entropy_of(probabilities: FloatArray) -> FloatArray:
    """Entropy of each row of probabilities, nats."""
    return np.asarray(-np.sum(probabilities * np.log(np.maximum(probabilities, 1e-300)), axis=-1))


def _zero_within(part: BinnedRun, keys: Iterable[Key], scale_kN: float) -> BinnedRun:
    """Blocks whose load cell has a zero that is off by no more than rivals of these sets allow, at a sliding force, kN.

    Where a constant force is among the rivals, a zero that is off by a size that matters is that constant, as in a
    diagnosis: it has a chance of `ALPHA`. Where it is not, there is no limit.
    """
    if not any(CONSTANT in key for key in keys):
        return part
    limit = MIN_EFFECT * scale_kN / -float(ndtri(ALPHA / 2.0))
    return replace(part, timing=replace(part.timing, zero_noise_kN=min(part.timing.zero_noise_kN, limit)))


def common_scales(runs: Sequence[Run], rig: Rig, protocols: Sequence[Protocol]) -> dict[str, Any]:
    """Scales of the coordinates over old runs and any of the protocols."""
    out: dict[str, Any] = {
        "half_stroke_mm": max(p.largest_mm for p in protocols),
        "peak_speed_mm_s": min(max(p.fastest_mm_s for p in protocols), rig.max_speed_mm_s) / 1.15,  # a 95th percentile
        "n_runs": len(runs) + 1,
        "tested_s": max(p.duration_s for p in protocols),
        "tested_m": max(p.travel_m for p in protocols),
    }
    if runs:
        last = histories([r.recording.time_s for r in runs], [r.motion for r in runs])[-1]
        out |= {name: max(out[name], getattr(last, name)) for name in ("half_stroke_mm", "peak_speed_mm_s")}
        out |= {name: out[name] + getattr(last, name) for name in ("tested_s", "tested_m")}
    assert set(out) == set(SCALES)
    return out


@one_blas_thread
def linearise(
    tested: DeviceUnderTest, scales: Mapping[str, Any], tell: Callable[[str], None] = lambda _: None
) -> PretestPosterior:
    """Fit the rivals to the old runs, at least one; `tell` gets one line for each step.

    `PlanError` if the device has had all the runs that a model takes, or a class is not known.
    """
    name, runs, device, sets = tested.name, tested.runs, tested.device, tested.sets
    if len(runs) >= MOST_RUNS:
        raise PlanError(f"{name} has {len(runs)} runs; a model takes {MOST_RUNS}, so no further one can be planned")
    own = data_of(runs, device)
    keys = [key for key, _ in sets]
    parts = [_zero_within(part, keys, own.scale_kN) for part in own.blocks]
    old = Blocks(replace(part, history=replace(part.history, **scales)) for part in parts)
    peak = own.blocks[0].history.peak_speed_mm_s  # noise at speeds beyond it is as it was there
    data = BinnedData(Likelihood(old, device), own.z, peak)
    known = {c.id: c for c in classes(tested.hidden, own.blocks[0].history.measured)}
    wanted = sorted(frozenset[str]().union(*keys))
    if missing := [c for c in wanted if c not in known]:
        raise PlanError(f"'{missing[0]}' is no class of dependence; known are {', '.join(known)}")
    needed = tuple(known[c] for c in wanted)
    tell(f"{name}: fitting {len(sets)} rivals to the tests so far")
    residual, slopes = data.likelihood.at(device).residual_and_slope(data.z[None])
    size = float(np.std(residual[0]))
    start = ErrorParameters(noise_of_size(device, size), max(size, 1e-6))
    rough = laplace(ErrorModel(data, start, slopes[0]), device, data.z)
    looked = candidates(data, rough, needed)
    metric = noise_beside(data, rough, looked, None)
    fitter = Fitter(looked, metric, tested.hidden)
    found = [(key, p, h) for key, p in sets for h in _ways(fitter, key)]
    if not found:
        raise PlanError(f"{name}: none of its rivals can be fitted; run diagnose again")
    best = max((h for _, _, h in found), key=lambda h: h.log_weight)
    setting = find_noise(data, best.state, np.zeros((best.state.residual.size, 0)), metric.setting)
    fitter = replace(fitter, metric=ErrorModel(data, setting, best.state.slope))
    fits = [(key, p, fitter.fitted(h.members, h.state.z) or h) for key, p, h in found]
    shares = _shares(fits, even=tested.untold)
    further = replace(device, n_runs=len(runs) + 1)
    last = old[-1].history
    kept = [i for i in np.argsort(-shares, kind="stable")[:MOST_RIVALS] if shares[i] > LEAST_SHARE * shares.max()]
    total = float(shares[kept].sum())
    rivals = [_rival(fitter.metric, fits[i][0], float(shares[i]) / total, fits[i][2]) for i in kept]
    z, middle = _joint(device, further, data.z)[0], float(last.motion.displacement_mm[0] - last.position_mm[0])
    return PretestPosterior(name, runs, further, z, old, scales, setting, tuple(rivals), middle, peak)


def before_any_test(device: DeviceModel, scales: Mapping[str, Any]) -> PretestPosterior:
    """Give what the priors alone say: the base law, or one curve beside it, about the median device."""
    device = replace(device, n_runs=1, effects=())
    z = np.zeros(device.n_law)
    setting = ErrorParameters((0.0,) * (len(device.names) - device.n_law), MODEL_ERROR * device.law_values(z)["Fy"])
    size = min(SIZES, key=lambda s: abs(math.log(s / TYPICAL)))
    odds = PRIOR_INCLUSION / (1.0 - PRIOR_INCLUSION)
    models: list[tuple[Key, float, DeviceModel]] = [(frozenset(), 1.0, device)]
    for action, coordinate in CURVES:
        curve = Curve(action, "heat2" if coordinate == "heat" else coordinate, SMOOTHNESS, False, size)
        models.append(
            (frozenset({str(DependenceId(action, coordinate))}), odds, device.with_effects((curve.effect(),)))
        )
    total, rivals = sum(p for _, p, _ in models), []
    for key, p, model in models:
        none = np.zeros(model.n_law + N_OF_DEVICE + N_OF_RUN)
        told = Gaussian(0.0, none, np.zeros((none.size, none.size)))
        rivals.append(RivalModel(key, p / total, model, none[: model.n_law], none, told))
    return PretestPosterior("a new device", (), device, z, Blocks(), scales, setting, tuple(rivals), 0.0)


def mechanisms_of(key: Key) -> tuple[str, ...]:
    """Mechanisms of the catalogue that a set of classes may be, in the order of its classes."""
    acting = (e.mechanism for word in sorted(key) for e in catalogue().values() if DependenceId.read(word) in e.acts)
    return tuple(dict.fromkeys(acting))


def class_of(mechanism: str) -> Key:
    """Set of classes of a mechanism that stands alone: none for ``velocity``, which the base law holds.

    `PlanError` where it is not in the catalogue.
    """
    if mechanism == "velocity":
        return frozenset()
    known = catalogue()
    if mechanism not in known:
        raise PlanError(f"'{mechanism}' is no mechanism; known are {', '.join(known)}{did_you_mean(mechanism, known)}")
    return frozenset({str(DependenceId(*known[mechanism].acts[0]))})


def _shares(fits: Sequence[tuple[Key, float, Hypothesis]], *, even: bool) -> FloatArray:
    """Probability of each fit: that of its set, divided over the ways to write it by their evidence."""
    logs = np.array([h.log_weight - len(h.members) * LOG_PRIOR_ODDS for _, _, h in fits])
    before = np.log([max(p, 1e-12) for _, p, _ in fits])
    if not even:
        for key in {key for key, _, _ in fits}:
            own = np.array([k == key for k, _, _ in fits])
            logs[own] -= logsumexp(logs[own])
    return np.asarray(np.exp(before + logs - logsumexp(before + logs)))


def _ways(fitter: Fitter, key: Key) -> list[Hypothesis]:
    """Fit a set of classes: curves of the likely kinds, and formulas in the place of the last of them."""
    ways = [h for h in (fitter.fitted((), fitter.metric.data.z),) if h is not None]
    for left in range(len(key), 0, -1):
        if not ways:
            return []
        h = max(ways, key=lambda h: h.log_weight)
        listed = [c for c in fitter.screen(h) if c.of.id in key - h.key]
        ways = []
        for c in [c for c in listed if c.of.id == listed[0].of.id][: KINDS if left == 1 else 1]:
            start = np.concatenate([h.state.z, c.start[-len(c.variant.effect.parameters) :]])
            ways += [new for new in (fitter.fitted((*h.members, c), start),) if new is not None]
    curve = next((h for h in ways if h.members and h.members[-1].variant.curve is not None), None)
    forms: dict[str, Candidate] = {}  # one of each effect
    for form in fitter.forms(curve, len(curve.members) - 1) if curve else ():
        forms.setdefault(form.variant.effect.id, form)
    for form in forms.values():
        assert curve is not None
        ways += [new for new in (fitter.fitted((*curve.members[:-1], form), form.start),) if new is not None]
    one_each: dict[tuple[str, ...], Hypothesis] = {}  # of an effect that was fitted from several starts
    for h in sorted(ways, key=lambda h: -h.log_weight):
        one_each.setdefault(tuple(m.variant.effect.id for m in h.members), h)
    top = max((h.log_weight for h in ways), default=0.0)
    return [h for h in one_each.values() if h.log_weight > top - NEAR]


def _joint(model: DeviceModel, further: DeviceModel, z: FloatArray) -> tuple[FloatArray, list[int]]:
    """Parameters of a model with one run more, and where the old ones stand among them."""
    known = dict(zip(model.law_names, z, strict=True))
    last = run_name("ratio", model.n_runs)
    at, places = np.zeros(further.n_law), []
    for i, name in enumerate(further.law_names):
        if name in known:
            at[i] = known[name]
            places.append(i)
        elif "." not in name:
            base = base_and_run(name)[0]
            at[i] = known.get(last if base == "ratio" else base, 0.0)
    return at, places


def _rival(metric: ErrorModel, key: Key, share: float, h: Hypothesis) -> RivalModel:
    """Condense a fit to the Gaussian that it leaves behind."""
    further = replace(h.state.model, n_runs=h.state.model.n_runs + 1)
    z, places = _joint(h.state.model, further, h.state.z)
    white = metric.whitened(h.state.beside())
    n, (disturbed, of_runs) = white.shape[0], np.split(metric.other, [N_OF_DEVICE], axis=1)
    unknown = np.zeros((n, N_OF_RUN))  # start and zero of the run to come
    design = np.concatenate([white[:, :1], np.zeros((n, z.size)), disturbed, unknown, of_runs], axis=1)
    design[:, 1 + np.array(places)] = white[:, 1:]
    gaussian = Gaussian.of(design.T @ design)
    mean = gaussian.mean.copy()
    new = np.setdiff1d(np.arange(z.size), places)
    mean[new] += z[new]  # what is new of the further run is expected as it was in the last one
    return RivalModel(key, share, further, z, mean, gaussian)
