"""Where the walkers start: the most probable parameters (MAP) and the curvature there."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy.optimize import brentq, least_squares, minimize, minimize_scalar

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import InferenceError
from shj_bayes.inference.binning import BinnedRun, Blocks
from shj_bayes.inference.likelihood import STEP, Density, Likelihood, SharedDensity, n_threads
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.filter import AT_REST_SD, log_density
from shj_bayes.model.parameters import base_and_run

Z_LIMIT = 12.0  # of the standardised parameters
N_STARTS = 5


def law_residuals(likelihood: Likelihood, z: FloatArray) -> FloatArray:
    """Residual of all blocks beside a constant of each run, for parameters of the law, (m, n_law) to (m, n), kN."""
    theta, out = likelihood.model.laws.natural(z), []
    for part in likelihood.blocks:
        own = part.residual_and_slope(part.force(likelihood.model, theta))[0]
        share = part.count / max(float(part.count.sum()), 1.0)
        out.append(np.where(part.count > 0, own - (own @ share)[:, None], 0.0))
    return np.concatenate(out, axis=1)


def law_residual(likelihood: Likelihood, z: FloatArray) -> FloatArray:
    """Give the same at one parameter set, shape (n_law,) to (n,), kN."""
    return np.asarray(law_residuals(likelihood, z[None])[0])


def descend(likelihood: Likelihood, z: FloatArray, sigma_kN: float, *, rounds: int = 40) -> FloatArray:
    """Go from `z` (unbounded, shape (n_law,)) to where squares and priors are least, in so many rounds at most.

    `sigma_kN` is the noise scale against which the priors count.
    """

    def misfit(z: FloatArray) -> FloatArray:
        inside = np.clip(z, -Z_LIMIT, Z_LIMIT)
        return np.concatenate([law_residual(likelihood, inside) / sigma_kN, z])

    def slope(z: FloatArray) -> FloatArray:
        return np.vstack([jacobian(likelihood, np.clip(z, -Z_LIMIT, Z_LIMIT)) / -sigma_kN, np.eye(z.size)])

    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(misfit(z)).all():
            return z
        found = least_squares(misfit, z, jac=slope, method="lm", ftol=1e-5, xtol=1e-6, max_nfev=rounds)
    return np.clip(found.x, -Z_LIMIT, Z_LIMIT) if np.isfinite(found.cost) else z


def jacobian(likelihood: Likelihood, z: FloatArray) -> FloatArray:
    """Give the derivatives of the force after the unbounded law parameters, shape (n, n_law), 0 without evidence."""
    before = law_residual(likelihood, z)
    columns = []
    for i in range(z.size):
        moved = z.copy()
        moved[i] += STEP
        columns.append((before - law_residual(likelihood, moved)) / STEP)
    return np.stack(columns, axis=1)


def cost(residual: FloatArray, z: FloatArray, sigma_kN: float) -> float:
    """Sum of squares in units of the noise, with the priors as springs on the standardised parameters."""
    value = float(residual @ residual) / sigma_kN**2 + float(z @ z)
    return value if np.isfinite(value) else np.inf


def best_of(likelihood: Likelihood, starts: Sequence[FloatArray], sigma_kN: float) -> FloatArray:
    """Descend from several starts: all for a few steps, the best two to the end; give the better end."""
    short = [descend(likelihood, z, sigma_kN, rounds=4) if len(starts) > 2 else z for z in starts]
    costs = [cost(law_residual(likelihood, z), z, sigma_kN) for z in short]
    ends = [descend(likelihood, short[i], sigma_kN) for i in np.argsort(costs, kind="stable")[:2]]
    return ends[int(np.argmin([cost(law_residual(likelihood, end), end, sigma_kN) for end in ends]))]


def extended(z: FloatArray, smaller: DeviceModel, larger: DeviceModel, effect: Effect) -> list[FloatArray]:
    """List starts of a model with one more effect: the smaller model's parameters and the effect's start values."""
    tails = [dict(zip(effect.names, values, strict=True)) for values in product(*start_values(effect))]
    known = dict(zip(smaller.law_names, z, strict=True))
    names = larger.law_names
    return [
        np.array([known[n] if n in known else tail[n.removeprefix(f"{effect.id}.")] for n in names]) for tail in tails
    ]


def promising(
    likelihood: Likelihood, before: FloatArray, slopes: FloatArray, starts: Sequence[FloatArray]
) -> list[FloatArray]:
    """Choose at most `N_STARTS` starts, shape (n_law,): those whose change of the force goes best with the residual.

    A moment in time or a wave length has a narrow basin; its grid is scanned to first order, not descended from. The
    last effect of the model is the new one. What the parameters without it can follow, by their `slopes`, shape (n, k),
    counts for none in the residual `before`, shape (n,), kN.
    """
    if len(starts) <= N_STARTS:
        return list(starts)
    changes = np.stack([before - law_residual(likelihood, z) for z in starts], axis=1)
    own = orthogonal_to(slopes, changes)
    along = own.T @ before / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    size = likelihood.model.effects[-1].parameters[0]
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


FAR = 1e12  # in the place of a negative log density that is none
NOISE_STEP = 0.01  # of the unbounded parameters of the noise, for differences: their standard deviations are as large
NOISE_CLOSE = 0.01  # nats below the top at which a search for the noise ends
ROUNDS = 60  # of such a search at most
FARTHEST = 3.0  # standard deviations of the force with which a run begins, from what is read
N_DESCENTS = 3  # laws of the grid that are improved
QUARTILES = np.array([0.25, 0.5, 0.75])
CHUNK = 16  # parameter sets evaluated in one call


@dataclass(frozen=True, eq=False)
class Start:
    """Most probable point and a Gaussian around it."""

    free: FloatArray  # shape (d,): MAP in the unbounded space
    covariance: FloatArray  # shape (d, d): inverse of the negative Hessian there
    log_posterior: float  # log posterior density there (unbounded space)


def find_start(
    likelihood: Likelihood, *, threads: int = 1, tops: Sequence[FloatArray] = ()
) -> tuple[Likelihood, Start]:
    """Find the most probable parameters: a grid of laws, least squares, effects one by one, then the posterior's top.

    Further points to climb from (`tops`, shape (n_law,), unbounded) are where a search has been already. Gives the
    posterior with blocks that follow the bends of its force, and its top; `InferenceError` if no parameters give a
    finite density.
    """
    candidates = [*tops, *law_starts(likelihood)]
    sizes = [float(np.std(law_residual(likelihood, z))) for z in candidates]
    best = candidates[int(np.argmin(sizes))]
    refined = started(likelihood, best).refined(best)
    n = n_threads(threads)
    with ThreadPoolExecutor(n) as pool:
        full = [_best_noise(refined, z) for z in candidates]
        even = polish(SharedDensity(refined, pool, n), full)
        refined, z = _with_best_noise_at_rest(refined, even.free)
        return refined, polish(SharedDensity(refined, pool, n), [z])


def started(likelihood: Likelihood, z: FloatArray) -> Likelihood:
    """Begin each run that does not rest unloaded with the force that is most probable at parameters of the law.

    They are unbounded, shape (n_law,). What is read there has noise, and the part of the speed in it. What is left of
    its error is small, so that it acts like one of the first turning point.
    """
    theta = likelihood.model.laws.natural(z[None])
    parts = (_started(part, likelihood.model, theta) if part.run.start_noise_kN else part for part in likelihood.blocks)
    return replace(likelihood, blocks=Blocks(parts))


def _started(part: BinnedRun, model: DeviceModel, theta: FloatArray) -> BinnedRun:
    """Begin a run with the force that its first half-cycle makes most probable, theta of shape (1, d)."""
    read, known = part.run.start_force_kN, part.run.start_noise_kN
    first = np.arange(part.n) < part.timing.half[1]

    def squares(begins_kN: float) -> FloatArray:
        force = model.force(theta, part.history, begins_kN)
        return np.asarray(part.count * part.residual_and_slope(force)[0][0] ** 2)

    noise = max(float(squares(read)[~first].sum() / max(part.count[~first].sum(), 1.0)), 1e-12 * known**2)

    def height(begins_kN: float) -> float:
        return float(squares(begins_kN)[first].sum()) / noise + ((begins_kN - read) / known) ** 2

    bounds = (read - FARTHEST * known, read + FARTHEST * known)
    begins_kN = float(minimize_scalar(height, bounds=bounds, method="bounded").x)
    return replace(part, run=replace(part.run, begins_kN=begins_kN))


def law_starts(likelihood: Likelihood) -> list[FloatArray]:
    """Fit a model's law by least squares, best first: the base law from a grid, then with one effect more at a time.

    In the unbounded space, each of shape (n_law,).
    """
    model = likelihood.model

    def with_first(k: int) -> Likelihood:
        return likelihood.at(model.with_effects(model.effects[:k]))

    found = _best_laws(with_first(0))
    for k in range(len(model.effects)):
        found = [_with_next_effect(with_first(k), with_first(k + 1), found[0])]
    return found


def _best_laws(likelihood: Likelihood) -> list[FloatArray]:
    """Take the best laws of a coarse grid to where the squares are least, best first; the model has no effects."""
    grid = _grid(likelihood)
    with np.errstate(over="ignore", invalid="ignore"):
        pieces = (grid[i : i + CHUNK] for i in range(0, len(grid), CHUNK))
        scores = [np.sum(law_residuals(likelihood, piece) ** 2, axis=1) for piece in pieces]
    order = np.argsort(np.concatenate(scores), kind="stable")
    near = [np.clip(z, -8.0, 8.0) for z in grid[order[:N_DESCENTS]]]
    ends = [descend(likelihood, z, max(float(np.std(law_residual(likelihood, z))), 1e-9)) for z in near]
    return sorted(ends, key=lambda z: float(np.sum(law_residual(likelihood, z) ** 2)))


def _with_next_effect(smaller: Likelihood, larger: Likelihood, z: FloatArray) -> FloatArray:
    """Least squares of a model with one more effect, from the best of the smaller one."""
    effect = larger.model.effects[-1]
    residual, slopes = law_residual(smaller, z), jacobian(smaller, z)
    starts = promising(larger, residual, slopes, extended(z, smaller.model, larger.model, effect))
    return best_of(larger, starts, max(float(np.std(residual)), 1e-9))


def _grid(likelihood: Likelihood) -> FloatArray:
    """List laws on a coarse grid, in the unbounded space, shape (n, n_law)."""
    runs, model = likelihood.runs, likelihood.model
    peak = [float(np.percentile(np.abs(run.recording.force_kN), 97)) for run in runs]
    stroke = float(np.ptp(runs[0].motion.displacement_mm))
    speed = float(np.percentile(runs[0].motion.speed_mm_s, 95))
    if not (peak[0] > 0 and stroke > 0 and speed > 0):
        raise InferenceError(
            f"nothing to fit: largest force {peak[0]:.3g} kN, stroke {stroke:.3g} mm, speed "
            f"{speed:.3g} mm/s; all must be above 0"
        )
    names = model.law_names
    rows = []
    for share, knee, beta, effect in product(
        (0.5, 0.7, 0.85, 1.0), (3, 8, 20, 60, 200), (3.0, 12.0, 80.0), (-0.2, 0.0, 0.25)
    ):
        values = {"K": knee * peak[0] / stroke, "Fy": share * peak[0], "beta": beta, "gamma": effect / speed}
        row = []
        for name in names:
            base, run = base_and_run(name)
            row.append(peak[run - 1] / peak[0] if base == "ratio" else values[base])
        rows.append([float(p.to_free(np.asarray(v))) for p, v in zip(model.laws, row, strict=False)])
    return np.array(rows)


def _best_noise(likelihood: Likelihood, z: FloatArray) -> FloatArray:
    """Complete law parameters with the most probable noise parameters of a grid around the size of the residual."""
    model = likelihood.model
    size = max(float(np.std(law_residual(likelihood, z))), 1e-9)
    grids = []
    for own, law in zip(model.noise.own, model.laws[model.n_law :], strict=True):
        values = np.array(own.in_fit) * (size if own.unit == "kN" else 1.0) if own.in_fit else law.quantile(QUARTILES)
        grids.append([float(law.to_free(value)) for value in values])
    rows = np.array(list(product(*grids)))
    points = np.concatenate([np.tile(z, (rows.shape[0], 1)), np.clip(rows, -8.0, 8.0)], axis=1)
    return np.asarray(points[int(np.argmax(likelihood.log_posterior_free(points)))])


def _with_best_noise_at_rest(likelihood: Likelihood, z: FloatArray) -> tuple[Likelihood, FloatArray]:
    """Give the posterior its most probable `at_rest`, and `z`, shape (d,), the noise beside it; the law stays.

    The widths of the law's parameters depend on it in the second order only, so it is not sampled (decision 0010).
    """
    model = likelihood.model
    law = model.laws.natural(z[None])
    held = [part.residual_and_slope(part.force(model, law)) for part in likelihood.blocks]

    def negative(u: FloatArray) -> float:
        noise = model.noise_values(model.laws.natural(np.append(z[: model.n_law], u[:-1])[None]))
        parts = zip(held, likelihood.with_noise_at_rest(AT_REST_SD * float(u[-1])).blocks, strict=True)
        likely = [log_density(model.noise, noise, *pair, part.timing).sum() for pair, part in parts]
        return 0.5 * float(u @ u) - float(np.sum(likely))

    found = most_probable_noise(negative, [np.append(z[model.n_law :], 0.0)], 8.0)
    return likelihood.with_noise_at_rest(AT_REST_SD * float(found[-1])), np.append(z[: model.n_law], found[:-1])


def most_probable_noise(
    negative: Callable[[FloatArray], float], firsts: Sequence[FloatArray], limit: FloatArray | float
) -> FloatArray:
    """Where a negative log density of the noise is least within +-`limit`, from the best of some points, shape (p,).

    By Newton's steps within a region of trust: the size of the noise is known to a hundredth, its memory to a factor,
    so that steps along the slope alone need hundreds of values.
    """

    def within(u: FloatArray) -> float:
        inside = np.clip(u, -limit, limit)
        value = negative(inside)
        return value + FAR * float(np.sum((u - inside) ** 2)) if np.isfinite(value) else FAR

    at = min(firsts, key=within) if len(firsts) > 1 else firsts[0]
    now, reach = within(at), 1.0
    for _ in range(ROUNDS):
        slope, bent = _expansion(within, at, now)
        values, axes = np.linalg.eigh(bent)
        curvature, along = np.maximum(np.abs(values), 1e-3), -axes.T @ slope  # away from a saddle, too
        if 0.5 * float(np.sum(along**2 / curvature)) < NOISE_CLOSE:
            break
        while reach > 1e-4:
            step = step_within(reach, along, curvature)
            goes, then = float(np.linalg.norm(step)), within(at + axes @ step)
            if then < now:
                break
            reach = 0.25 * min(reach, goes)
        else:
            break
        gain, expected = now - then, float(step @ (along - 0.5 * curvature * step))
        reach = reach_after(reach, goes, gain / expected)
        at, now = at + axes @ step, then
    return np.asarray(np.clip(at, -limit, limit))


def _expansion(value: Callable[[FloatArray], float], at: FloatArray, here: float) -> tuple[FloatArray, FloatArray]:
    """First and second derivatives of a function at a point, shapes (p,) and (p, p), by central differences."""
    steps = NOISE_STEP * np.eye(at.size)
    up, down = (np.array([value(at + sign * step) for step in steps]) for sign in (1.0, -1.0))
    bent = np.diag(up + down - 2.0 * here)
    for i, j in combinations(range(at.size), 2):
        bent[i, j] = bent[j, i] = value(at + steps[i] + steps[j]) - up[i] - up[j] + here
    return (up - down) / (2.0 * NOISE_STEP), bent / NOISE_STEP**2


def polish(density: Density, candidates: Sequence[FloatArray]) -> Start:
    """Climb from each candidate, shape (d,), to the top of the density; return the highest, with the curvature there.

    `InferenceError` if no candidate has a finite density.
    """
    best: Start | None = None
    climbed: list[FloatArray] = []
    for candidate in candidates:
        origin = np.clip(candidate, -8.0, 8.0)
        # The same hill: at its top already, or where an earlier climb began. Many samples make a top so narrow that
        # the ends of all least-squares searches, one point to six digits, are some standard deviations from it.
        if best is not None and min(_distance(best, origin, from_) for from_ in (best.free, *climbed)) < 1.0:
            continue
        climbed.append(origin)
        if not np.isfinite(density.log_posterior_free(origin[None])[0]):
            continue
        # In units of the curvature the climb takes a dozen steps; in the parameters' own units it takes ninety.
        root = np.linalg.cholesky(_covariance(density, origin))
        result = minimize(
            _negative_with_gradient,
            np.zeros(origin.size),
            args=(density, origin, root),
            jac=True,
            method="BFGS",
            options={"maxiter": 300, "gtol": 1e-3},
        )
        if np.isfinite(result.fun) and (best is None or -result.fun > best.log_posterior):
            top = origin + root @ result.x
            best = Start(top, _covariance(density, top), -float(result.fun))
    if best is None:
        raise InferenceError("no parameters within the priors give a finite likelihood; look at `shj-bayes check`")
    return best


def _distance(start: Start, z: FloatArray, origin: FloatArray) -> float:
    """Distance of two points in standard deviations at the top."""
    gap = z - origin
    return float(np.sqrt(gap @ np.linalg.solve(start.covariance, gap)))


def _negative_with_gradient(
    u: FloatArray, density: Density, origin: FloatArray, root: FloatArray
) -> tuple[float, FloatArray]:
    """Negative log posterior at origin + root u and its central-difference gradient, all points in one call."""
    step = 1e-3
    shifts = step * np.vstack([np.zeros(u.size), np.eye(u.size), -np.eye(u.size)])
    value = density.log_posterior_free(origin + (u + shifts) @ root.T)
    if not np.all(np.isfinite(value)):
        return 1e300, np.zeros(u.size)
    gradient = (value[1 : 1 + u.size] - value[1 + u.size :]) / (2 * step)
    return -float(value[0]), -gradient


def _covariance(density: Density, z: FloatArray) -> FloatArray:
    """Inverse of the negative Hessian, by differences of about half a posterior standard deviation."""
    d = z.size
    top = float(density.log_posterior_free(z[None])[0])
    width = np.full(d, 1e-4)
    for _ in range(3):  # find the scale on which the log density falls by about 1/8
        both = density.log_posterior_free(z + np.vstack([np.diag(width), -np.diag(width)]))
        fall = np.maximum(2 * top - both[:d] - both[d:], 1e-10)
        width = np.clip(width * np.sqrt(0.25 / fall), 1e-7, 0.5)
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    points = [
        z + s * width * np.eye(d)[i] + t * width * np.eye(d)[j] for i, j in pairs for s in (1, -1) for t in (1, -1)
    ]
    value = density.log_posterior_free(np.array(points)).reshape(-1, 4)
    hessian = np.zeros((d, d))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, value, strict=True):
        hessian[i, j] = hessian[j, i] = (pp - pm - mp + mm) / 4
    if not np.all(np.isfinite(hessian)):  # beside the edge of what doubles can hold
        return np.diag(width**2)
    values, vectors = np.linalg.eigh(-(hessian + hessian.T) / 2)
    values = np.maximum(values, 1e-3 * max(values.max(), 1e-3))  # a flat direction starts wide, not infinite
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse * np.outer(width, width))
