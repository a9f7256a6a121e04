"""Least squares of the force, held by the priors: where every search for the most probable parameters begins."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import brentq, least_squares

from shj_bayes.inference.posterior import Posterior
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.parameters import FloatArray

STEP = 1e-4  # of the standardised free parameter; small against any posterior, large against rounding
Z_LIMIT = 12.0  # of the standardised parameters
N_STARTS = 5


@dataclass(frozen=True, eq=False)
class LawOnly:
    """A posterior as least squares sees it: the parameters of its law, and the residual of its blocks."""

    posterior: Posterior  # what is fitted

    def residual(self, z: FloatArray) -> FloatArray:
        """Residual of all blocks, shape (n,), kN."""
        return np.asarray(self.residuals(z[None])[0])

    def residuals(self, z: FloatArray) -> FloatArray:
        """Residual of all blocks beside a constant of each run, for many parameter sets, (m, n_law) to (m, n), kN."""
        theta = self.posterior.model.natural_of_law(z)
        out = []
        for run, part in enumerate(self.posterior.averages, start=1):
            own = self.posterior.residual_and_slope(theta, run)[0]
            share = part.count / max(float(part.count.sum()), 1.0)
            out.append(np.where(part.count > 0, own - (own @ share)[:, None], 0.0))
        return np.concatenate(out, axis=1)


def descend(law: LawOnly, z: FloatArray, sigma_kN: float, *, rounds: int = 40) -> FloatArray:
    """Go from `z` (unbounded, shape (n_law,)) to where squares and priors are least, in so many rounds at most.

    `sigma_kN` is the noise scale against which the priors count.
    """

    def misfit(z: FloatArray) -> FloatArray:
        inside = np.clip(z, -Z_LIMIT, Z_LIMIT)
        return np.concatenate([law.residual(inside) / sigma_kN, z])

    def slope(z: FloatArray) -> FloatArray:
        return np.vstack([jacobian(law, np.clip(z, -Z_LIMIT, Z_LIMIT)) / -sigma_kN, np.eye(z.size)])

    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(misfit(z)).all():
            return z
        found = least_squares(misfit, z, jac=slope, method="lm", ftol=1e-5, xtol=1e-6, max_nfev=rounds)
    return np.clip(found.x, -Z_LIMIT, Z_LIMIT) if np.isfinite(found.cost) else z


def jacobian(law: LawOnly, z: FloatArray) -> FloatArray:
    """Give the derivatives of the force after the unbounded law parameters, shape (n, n_law), 0 without evidence."""
    before = law.residual(z)
    columns = []
    for i in range(z.size):
        moved = z.copy()
        moved[i] += STEP
        columns.append((before - law.residual(moved)) / STEP)
    return np.stack(columns, axis=1)


def cost(residual: FloatArray, z: FloatArray, sigma_kN: float) -> float:
    """Sum of squares in units of the noise, with the priors as springs on the standardised parameters."""
    value = float(residual @ residual) / sigma_kN**2 + float(z @ z)
    return value if np.isfinite(value) else np.inf


def best_of(law: LawOnly, starts: Sequence[FloatArray], sigma_kN: float) -> FloatArray:
    """Descend from several starts: all for a few steps, the best two to the end; give the better end."""
    short = [descend(law, z, sigma_kN, rounds=4) if len(starts) > 2 else z for z in starts]
    costs = [cost(law.residual(z), z, sigma_kN) for z in short]
    ends = [descend(law, short[i], sigma_kN) for i in np.argsort(costs, kind="stable")[:2]]
    return ends[int(np.argmin([cost(law.residual(end), end, sigma_kN) for end in ends]))]


def extended(z: FloatArray, smaller: DeviceModel, larger: DeviceModel, effect: Effect) -> list[FloatArray]:
    """List starts of a model with one more effect: the smaller model's parameters and the effect's start values."""
    tails = [dict(zip(effect.names, values, strict=True)) for values in product(*start_values(effect))]
    known = dict(zip(smaller.law_names, z, strict=True))
    names = larger.law_names
    return [
        np.array([known[n] if n in known else tail[n.removeprefix(f"{effect.id}.")] for n in names]) for tail in tails
    ]


def promising(law: LawOnly, before: FloatArray, slopes: FloatArray, starts: Sequence[FloatArray]) -> list[FloatArray]:
    """Choose at most `N_STARTS` starts, shape (n_law,): those whose change of the force goes best with the residual.

    A moment in time or a wave length has a narrow basin; its grid is scanned to first order, not descended from. The
    last effect of `law` is the new one. What the parameters without it can follow, by their `slopes`, shape (n, k),
    counts for none in the residual `before`, shape (n,), kN.
    """
    if len(starts) <= N_STARTS:
        return list(starts)
    changes = np.stack([before - law.residual(z) for z in starts], axis=1)
    own = orthogonal_to(slopes, changes)
    along = own.T @ before / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    size = law.posterior.model.effects[-1].parameters[0]
    score = np.abs(along) if size.either_sign else along  # a size of one sign must go along
    return [starts[i] for i in np.argsort(-score, kind="stable")[:N_STARTS]]


def orthogonal_to(slopes: FloatArray, columns: FloatArray) -> FloatArray:
    """Reduce columns to what is left when all that the fitted parameters can follow is taken out."""
    scale = np.linalg.norm(slopes, axis=0)
    q = np.linalg.qr(slopes[:, scale > 0] / scale[scale > 0])[0]
    return np.asarray(columns - q @ (q.T @ columns))


def step_within(reach: float, along: FloatArray, curvature: FloatArray) -> FloatArray:
    """Step to the least of a quadratic within a distance, along the axes of its curvature, shape (p,).

    `along` is how steeply it falls along each axis at the start. Moré and Sorensen 1983, SIAM J. Sci. Stat. Comput. 4,
    553.
    """

    def beyond(damping: float) -> float:
        return float(np.linalg.norm(along / (curvature + damping))) - reach

    damping = 0.0 if beyond(0.0) <= 0.0 else brentq(beyond, 0.0, float(np.linalg.norm(along)) / reach, rtol=1e-3)
    return np.asarray(along / (curvature + damping))


def reach_after(reach: float, goes: float, kept: float) -> float:
    """Distance that a quadratic is trusted over after a step of length `goes`, which did `kept` of what it foretold."""
    if kept > 0.7:
        return max(reach, 2.0 * goes)
    return 0.5 * min(reach, goes) if kept < 0.25 else reach


def start_values(effect: Effect) -> list[list[float]]:
    """Values in the unbounded space from which a search begins, for each parameter of an effect."""
    out = []
    for prior in effect.parameters:
        begin = 0.05 / prior.b if prior.name in effect.neutral and prior.either_sign else 0.0
        given = effect.start.get(prior.name, ())
        out.append([float(prior.to_free(np.asarray(float(value)))) for value in given] or [begin])
    return out


def root_of(covariance: FloatArray) -> FloatArray:
    """Give a matrix R with R R^T = covariance, shape (d, d): a Cholesky factor where rounding has left it one.

    Of parameters that the data hardly tell apart the smallest eigenvalues are rounding errors, of either sign.
    """
    try:
        return np.asarray(np.linalg.cholesky(covariance + 1e-14 * np.eye(covariance.shape[0])), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
        return np.asarray(axes * np.sqrt(np.maximum(values, 1e-14 * max(1.0, float(values[-1])))), dtype=np.float64)
