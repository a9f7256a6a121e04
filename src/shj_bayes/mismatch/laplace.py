"""A model at its most probable parameters, and how it gets there."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.gaussian import Gaussian
from shj_bayes.inference.start import most_probable_noise, orthogonal_to, reach_after, root_of, step_within
from shj_bayes.mismatch.data import MODEL_ERROR, BinnedData, ErrorModel, ErrorParameters
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect

Z_LIMIT = 12.0
ROUNDS = 40
REACH = 3.0  # of the first step, standard deviations of the parameters before the test
VALUES_SEEN = 2.0  # independent values of slow noise in a run: a force that goes one way throughout is a drift
CLOSE = 1e-2  # square of the last step, in posterior standard deviations


@dataclass(frozen=True, eq=False)
class Laplace:
    """A model at its most probable parameters under a metric."""

    model: DeviceModel
    z: FloatArray  # shape (n_law,): parameters of its law in the unbounded space
    residual: FloatArray  # shape (n,): measured less modelled force of each block, kN
    slope: FloatArray  # shape (n,): of the latter, kN/mm
    jacobian: FloatArray  # shape (n, n_law): derivatives of the force
    gaussian: Gaussian  # the linearised data and the derivatives
    covariance: FloatArray  # shape (n_law, n_law): of the parameters
    evidence: float  # log density of the data, parameters integrated out (Laplace)

    def of_law(self, device: DeviceModel) -> FloatArray:
        """Give the parameters of a smaller model, those of the law alone for instance, where they are in this one."""
        return self.z[np.isin(self.model.law_names, device.law_names)]

    def values_of(self, effect: Effect) -> dict[str, float]:
        """Give the parameters of an effect of the model, by their names in the effect."""
        law = self.model.law_values(self.z)
        return {name: law[f"{effect.id}.{name}"] for name in effect.names}

    def beside(self, *columns: FloatArray) -> FloatArray:
        """Give the linearised data, the derivatives and further columns, shape (n, 1 + n_law + p), for a product."""
        return np.column_stack([self.residual + self.jacobian @ self.z, self.jacobian, *columns])


def drawn_from(state: Laplace, n: int, seed: int = 1) -> FloatArray:
    """Draw from the Gaussian around the most probable parameters, shape (n, n_law)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    root = root_of(state.covariance)
    return np.asarray(state.z + rng.standard_normal((n, state.z.size)) @ root.T)


def laplace(metric: ErrorModel, model: DeviceModel, z: FloatArray, floor: float = -math.inf) -> Laplace:
    """Go to the most probable parameters by steps of Gauss-Newton from `z`, shape (n_law,), and linearise there.

    Steps are kept as short as the derivatives have foretold them well: from far away a formula is no straight line. It
    ends on the way where steps like the last one would not reach a log density of `floor`.
    """

    def height(residual: FloatArray, at: FloatArray) -> float:
        if not np.all(np.isfinite(residual)):
            return math.inf
        return float(metric.products(residual[:, None])[0, 0] + at @ at)

    likelihood = metric.data.likelihood.at(model)
    both = likelihood.residual_and_slope(z[None])
    residual, slope = both[0][0], both[1][0]
    now, enough = height(residual, z), 2.0 * (metric.log_constant - floor)
    # Coefficients of curves act in proportion to their size: they may go far at once.
    unit = np.array([0.1 if law.either_sign else 1.0 for law in model.laws[: model.n_law]])
    reach = REACH
    for left in reversed(range(ROUNDS)):
        columns = likelihood.jacobian(z, residual)
        linear = metric.gaussian(np.column_stack([residual + columns @ z, columns]))
        fall = linear.along - linear.precision @ z
        if float(fall @ linear.solve(fall)) < CLOSE:
            break
        curvature, axes = np.linalg.eigh(linear.precision / np.outer(unit, unit))
        along = axes.T @ (fall / unit)
        while reach > 1e-3:
            step = step_within(reach, along, curvature)
            goes = float(np.linalg.norm(step))
            trial = np.clip(z + (axes @ step) / unit, -Z_LIMIT, Z_LIMIT)
            moved = likelihood.residual_and_slope(trial[None])
            then = height(moved[0][0], trial)
            if then <= now - CLOSE:
                break
            reach = 0.4 * min(reach, goes)
        else:
            break
        gain, expected = now - then, float(step @ (2.0 * along - curvature * step))
        now, z, residual, slope = then, trial, moved[0][0], moved[1][0]
        reach = reach_after(reach, goes, gain / expected)
        if now - left * gain > enough:
            break
    # At the top itself: the last step may have stopped beside it.
    evidence = metric.log_constant - 0.5 * now - linear.half_log_det
    return Laplace(model, z, residual, slope, columns, linear, linear.covariance, evidence)


def laplace_under(
    data: BinnedData, setting: ErrorParameters, model: DeviceModel, z: FloatArray
) -> tuple[ErrorModel, Laplace]:
    """Fit a model under a noise, with the error model that this noise makes where the model starts."""
    metric = ErrorModel(data, setting, data.likelihood.at(model).residual_and_slope(z[None])[1][0])
    return metric, laplace(metric, model, z)


def visible(data: BinnedData, jacobian: FloatArray, change_kN: FloatArray) -> FloatArray:
    """Size of changes of the force, shape (n, p), that no change of the parameters can make up for, as shares of Fy.

    The 99th percentile over the samples of what is left, or of the change itself where that is less, shape (p,).
    """
    used = data.blocks.used > 0
    count, change = data.blocks.n_samples[used], change_kN[used]
    root = np.sqrt(count)[:, None]
    left = orthogonal_to(jacobian[used] * root, change * root) / root
    return np.minimum(largest(left, count), largest(change, count)) / data.scale_kN


def largest(columns: FloatArray, count: FloatArray) -> FloatArray:
    """99th percentile of the sizes in each column over samples, so many in each row, shape (n, p) to (p,)."""
    sizes = np.abs(columns)
    order = np.argsort(sizes, axis=0)
    reached = np.cumsum(count[order], axis=0) >= 0.99 * count.sum()
    ordered = np.take_along_axis(sizes, order, axis=0)
    return np.asarray(ordered[reached.argmax(axis=0), np.arange(sizes.shape[1])])


def zero_of(metric: ErrorModel, state: Laplace) -> tuple[float, float]:
    """Mean and standard deviation of the error of the load cell's zero, averaged over the runs, kN."""
    columns = np.column_stack([metric.whitened(state.beside()), metric.other])
    whole = Gaussian.of(columns.T @ columns)
    n = len(metric.data.blocks)
    zeros_kN = metric.data.missed_sizes(0.0)[-n:]
    weights = np.append(np.zeros(whole.along.size - n), zeros_kN / n)
    return float(weights @ whole.mean), math.sqrt(float(weights @ whole.solve(weights)))


def find_noise(
    data: BinnedData,
    state: Laplace,
    columns: FloatArray,
    start: ErrorParameters | None = None,
    most_kN: float = math.inf,
) -> ErrorParameters:
    """Find the noise of a device beside everything that a set of columns can take up.

    Of the state only residual and derivatives count; the columns, shape (n, p), have standard normal coefficients.
    Begins at the best of a grid by default; `most_kN` is the largest standard deviation, as of
    `ErrorParameters.size_kN`.
    A run holds at least `VALUES_SEEN` independent values of it (two memories are from one to the next).
    """
    missed = data.missed_at(state.slope)
    beside = np.column_stack([state.beside(columns), missed])
    known = np.ones(beside.shape[1] - 1 - missed.shape[1])
    unit = MODEL_ERROR * data.scale_kN
    lasts_s = max(float(np.ptp(part.history.time_s)) for part in data.blocks)
    laws = data.device.laws[data.device.n_law :]
    longest_s = np.asarray(lasts_s / (2.0 * VALUES_SEEN))
    most = np.array([float(law.to_free(longest_s)) if law.unit == "s" else math.inf for law in laws])

    def setting(u: FloatArray) -> ErrorParameters:
        noise = ErrorParameters(tuple(np.minimum(u[:-2], most).tolist()), unit * math.exp(float(u[-2])), float(u[-1]))
        return noise.at_most(data, most_kN)

    @lru_cache(maxsize=2 * len(laws) * (len(laws) + 3))  # those of one expansion
    def products(noise: ErrorParameters) -> tuple[FloatArray, float]:
        white, constant = noise.whitened(data, beside, state.slope)
        return white.T @ white, constant

    def negative(u: FloatArray) -> float:
        noise = setting(u)
        inner, constant = products(replace(noise, model_error_kN=unit))  # which whitens nothing
        constant += noise.log_prior(data)
        sizes = np.append(known, data.missed_sizes(noise.model_error_kN))
        try:
            return -Gaussian.of(inner, constant).sized(sizes).log_evidence
        except np.linalg.LinAlgError:  # noise so small that rounding tells nothing of one column beside the others
            return math.inf

    if start is None:
        grids = []
        for own, law in zip(data.device.noise.own, laws, strict=True):
            values = np.array(own.in_diagnosis) * (data.scale_kN if own.unit == "kN" else 1.0)
            values = values if own.in_diagnosis else law.quantile(np.array([0.5]))
            grids.append(np.clip(law.to_free(values), -7, 7).tolist())
        firsts = [np.array([*point, 0.0, 0.0]) for point in product(*grids)]
    else:
        firsts = [np.array([*start.z, math.log(start.model_error_kN / unit), start.at_rest])]
    return setting(most_probable_noise(negative, firsts, np.append(np.full(firsts[0].size - 2, 8.0), [6.0, 4.0])))
