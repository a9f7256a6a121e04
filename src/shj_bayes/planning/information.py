"""What a protocol is expected to tell: outcomes drawn from every rival, weighed by the evidence in linearised form.

Old tests leave a Gaussian for each rival. A planned run is linear in its parameters, with white and slow noise, so its
evidence under each rival is closed: outcomes are drawn from the rivals in their shares, and each gives probabilities
and a posterior without sampling (expected information of a design: Lindley 1956, Ann. Math. Statist. 27, 986).
"""

import math
from collections.abc import Callable
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PlanError, did_you_mean
from shj_bayes.inference.gaussian import Gaussian
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.model.history import histories
from shj_bayes.model.parameters import run_name
from shj_bayes.planning.protocol import Protocol
from shj_bayes.planning.rivals import PLANNED, PretestPosterior, entropy_of
from shj_bayes.population.readings import Readings, counted_from, of_readings, read_off
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording

OUTCOMES = 24  # drawn from each rival
SURE = 2.0  # standard deviations by which the force may be more than predicted
STEP = 1e-3  # of unbounded parameters, for central differences
WHICH, FORCE = "which", "force"
MARGIN = "least"  # as in the sheet of margins: smallest plateau force of the last test


class LinearQuantity(NamedTuple):
    """A design quantity as a linear function of each rival's parameters."""

    unit: str
    values: FloatArray  # shape (n_rivals,): at the mean of each rival
    slopes: tuple[FloatArray, ...]  # shape (n_law + p,) each: derivatives there
    # ``value(model, z)`` gives it for unbounded law parameters of a model, shape (n_law,)
    value: Callable[[DeviceModel, FloatArray], float]

    def now(self, known: PretestPosterior) -> tuple[float, float]:
        """Mean and standard deviation before the planned test, over all rivals."""
        own = [float(g @ rival.gaussian.solve(g)) for g, rival in zip(self.slopes, known.rivals, strict=True)]
        return float(known.shares @ self.values), math.sqrt(spread_of(known.shares, self.values, np.array(own)))


class ExpectedInformation(NamedTuple):
    """What a protocol is expected to give."""

    entropy: float  # expected entropy of the probabilities of the sets after it, nats
    of_truth: float  # expected probability of the true set
    right: float  # chance that the most probable set is the true one
    sd: float | None  # expected standard deviation of the quantity that is asked for (root of the mean variance)
    force_kN: float  # largest force, two standard deviations above what is predicted
    # log evidence by which a true contender leads another, nats: median over the outcomes of a form, smallest over
    # forms and pairs. A probability stops growing near 1; this does not, and leaves room for what the forms miss
    separation: float
    # error of the force of the base law for what readers get wrong of the motion: 99th percentile, as sizes are
    misread_kN: float


def spread_of(shares: FloatArray, means: FloatArray, variances: FloatArray) -> FloatArray:
    """Variance of a quantity over all rivals, along the last axis."""
    away = means - np.sum(shares * means, axis=-1, keepdims=True)
    return np.asarray(np.sum(shares * (variances + away**2), axis=-1))


def expected_information(
    known: PretestPosterior,
    protocol: Protocol,
    rate_Hz: float,
    seed: int,
    quantity: LinearQuantity | None = None,
    n: int = OUTCOMES,
) -> ExpectedInformation:
    """Weigh the outcomes that a protocol may have, `n` drawn from each rival; candidates share the seed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    rivals = known.rivals
    data, misread = as_read(known, protocol, rate_Hz, rng)
    linear, wrong, force_kN = _linearised(known, data, misread)
    outcomes = []  # drawn from each rival in units of the noise, shape (n_evidence, n)
    for rival, (mean, design) in zip(rivals, linear, strict=True):
        standard = rng.standard_normal((rival.mean.size, n))
        u = solve_triangular(rival.gaussian.root, standard, lower=True, trans="T", check_finite=False)
        u[: rival.z.size][~rival.drawn] = 0.0
        outcomes.append(mean[:, None] + design @ u + rng.standard_normal((mean.size, n)))
    drawn = np.concatenate(outcomes, axis=1) + wrong
    logs, values, variances = [], [], []
    for i, (rival, (mean, design)) in enumerate(zip(rivals, linear, strict=True)):
        after = foretold(rival.gaussian, design)
        away = drawn - mean[:, None]
        along = design.T @ away
        moved = after.solve(along)
        grown = after.half_log_det - rival.gaussian.half_log_det
        logs.append(-0.5 * (np.sum(away**2, axis=0) - np.sum(along * moved, axis=0)) - grown)
        if quantity is not None:
            values.append(quantity.values[i] + quantity.slopes[i] @ moved)
            variances.append(float(quantity.slopes[i] @ after.solve(quantity.slopes[i])))
    evidence = np.array(logs).T
    weights = evidence + np.log(known.shares)
    p = np.exp(weights - logsumexp(weights, axis=1, keepdims=True))  # (n_outcomes, n_rivals)
    chance, keys = np.repeat(known.shares / n, n), known.keys
    of_key = np.array([keys.index(rival.key) for rival in rivals])
    by_key = np.stack([p[:, of_key == k].sum(axis=1) for k in range(len(keys))], axis=1)
    truth = np.repeat(of_key, n)
    sd = None if quantity is None else math.sqrt(chance @ spread_of(p, np.array(values).T, np.array(variances)))
    return ExpectedInformation(
        entropy=float(chance @ entropy_of(by_key)),
        of_truth=float(chance @ by_key[np.arange(truth.size), truth]),
        right=float(chance @ (by_key.argmax(axis=1) == truth)),
        sd=sd,
        force_kN=force_kN,
        separation=_separation(known, evidence.reshape(len(rivals), n, len(rivals))),
        misread_kN=float(np.percentile(np.abs(misread[data.blocks.used > 0]), 99)),
    )


def foretold(before: Gaussian, columns: FloatArray) -> Gaussian:
    """Give a Gaussian with further data that its mean foretold, of such columns, shape (n, p)."""
    seen = columns @ before.mean
    along = before.along + columns.T @ seen
    return Gaussian(before.square + float(seen @ seen), along, before.inner + columns.T @ columns, before.constant)


def _separation(known: PretestPosterior, logs: FloatArray) -> float:
    """Give the smallest log evidence by which a true contender leads another, nats.

    This is the maximin of the Kullback-Leibler optimum (Lopez-Fidalgo, Tommasi and Trandafir 2007, J. R. Stat. Soc. B
    69, 231). Where one contender is another with a further effect, often no test tells them apart: such pairs count
    only if there are no other pairs. `logs`, shape (n_rivals, n, n_rivals), is the log evidence of every rival for the
    outcomes of each.
    """
    of_set = {}
    for key in known.contenders:
        own = [i for i, rival in enumerate(known.rivals) if rival.key == key]
        within = known.shares[own] / known.probabilities[key]
        of_set[key] = logsumexp(logs[:, :, own] + np.log(within), axis=2)
    pairs = list(permutations(of_set, 2))
    pairs = [(a, b) for a, b in pairs if not (a <= b or b <= a)] or pairs
    least = [
        float(np.median(of_set[a][i] - of_set[b][i]))
        for a, b in pairs
        for i, one in enumerate(known.rivals)
        if one.key == a
    ]
    return min(least, default=0.0)


def _linearised(
    known: PretestPosterior, data: BinnedData, misread: FloatArray
) -> tuple[list[tuple[FloatArray, FloatArray]], FloatArray, float]:
    """Linearise a planned run: mean and design of each rival and what all get wrong, in units of noise; largest kN."""
    first = known.rivals[0]
    metric = ErrorModel(data, known.setting, data.likelihood.at(first.model).residual_and_slope(first.z[None])[1][0])
    columns, forces = [metric.whitened(misread[:, None]), metric.other], []
    for rival in known.rivals:
        likelihood = data.likelihood.at(rival.model)
        residual = likelihood.residual(rival.z[None])[0]
        force, jacobian = (data.blocks.force_kN - residual) * data.blocks.used, likelihood.jacobian(rival.z, residual)
        told, own = jacobian * rival.drawn, rival.gaussian.covariance[: rival.z.size, : rival.z.size]
        forces.append(float(np.max(np.abs(force) + SURE * np.sqrt(np.einsum("ij,jk,ik->i", told, own, told)))))
        columns.append(metric.whitened(np.column_stack([force - jacobian @ rival.z, jacobian])))
    # In coordinates of the space that they span: their products, all that outcomes depend on, are the same.
    whole = np.concatenate(columns, axis=1)
    values, vectors = np.linalg.eigh(whole.T @ whole)
    reduced = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    wrong, other, *own_columns = np.split(reduced, np.cumsum([c.shape[1] for c in columns])[:-1], axis=1)
    linear = []
    for rival, white in zip(known.rivals, own_columns, strict=True):
        of_old_runs = np.zeros((white.shape[0], rival.mean.size - rival.z.size - other.shape[1]))
        design = np.concatenate([white[:, 1:], other, of_old_runs], axis=1)
        linear.append((white[:, 0] + design @ rival.mean, design))
    return linear, wrong, max(forces)


def as_read(
    known: PretestPosterior, protocol: Protocol, rate_Hz: float, rng: np.random.Generator
) -> tuple[BinnedData, FloatArray]:
    """Give a planned run as the readers will see it, and what they will get wrong of it, kN, shape (n_blocks,).

    Every rival is held against the motion that is found in the samples. Where this is not the motion that was run, as
    at the corners of a fast triangle, the force differs in a way that none of them holds: that of the base law along
    the motion that was run less that along the motion that is found.
    """
    time, motion = protocol.sampled(rate_Hz)
    noise = max((run.motion.noise_mm for run in known.runs), default=0.0)  # of the displacements of the old tests
    measured = motion.displacement_mm + noise * rng.standard_normal(time.size)
    found = motion_of(Recording(time, measured, np.zeros(time.size), source=PLANNED))
    run, read = (known.base_force(histories([time], [m])[0]) for m in (motion, found))
    data = known.data(time, found, run)
    return data, data.blocks.mean([run - read])


def quantity_of(
    known: PretestPosterior, unit: str, value: Callable[[DeviceModel, FloatArray], float]
) -> LinearQuantity:
    """Linearise a design quantity about every rival; `value` as in `LinearQuantity`."""
    values, slopes = [], []
    for rival in known.rivals:
        z, n = rival.mean[: rival.z.size], rival.z.size
        slope = np.zeros(rival.mean.size)
        slope[:n] = [(value(rival.model, z + s) - value(rival.model, z - s)) / (2 * STEP) for s in STEP * np.eye(n)]
        values.append(value(rival.model, z))
        slopes.append(slope)
    return LinearQuantity(unit, np.array(values), tuple(slopes), value)


def quantity_named(known: PretestPosterior, name: str) -> LinearQuantity:
    """Quantity of a name, for one device; `PlanError` where it has none of that name."""
    planned = run_name("ratio", known.device.n_runs)
    own = [n for n in known.device.law_names if "." not in n and n != planned]
    own += [MARGIN] if known.runs else []
    if name not in own:
        able = (WHICH, FORCE, *own)
        raise PlanError(f"{known.name}: '{name}' is no question; known are {', '.join(able)}{did_you_mean(name, able)}")
    if name != MARGIN:
        return quantity_of(known, meaning_of(name).unit, lambda model, z: model.law_values(z)[name])
    history, first = known.old[-1].history, known.rivals[0]

    def read(model: DeviceModel, z: FloatArray) -> Readings:
        force = model.force(model.laws.natural(z[None]), history, 0.0)
        return read_off(force, history.motion, history.travel_m)

    least = counted_from([read(first.model, first.z)])
    if not np.isfinite(least):
        raise PlanError(f"{known.name}: no half-cycle of its last test slides fully, so it has no plateau force")
    return quantity_of(known, "kN", lambda model, z: float(of_readings(read(model, z), least)["least"][0]))
