"""The fixed proposal of the independence moves: a mixture of t laws, fitted by adaptive importance sampling.

Nothing of it enters the posterior: a poor proposal only slows the sampler down.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import logsumexp

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.likelihood import Density
from shj_bayes.inference.start import Start, root_of

TAIL = 20.0  # degrees of freedom: nearly normal, as the posterior is near each point of its ridges
N_ROUNDS, N_DRAWS = (3, 14), 512  # rounds at least and at most
GOOD = 0.8  # efficiency with which the rounds end
COUNTED = 8.0  # effective draws per parameter that a fit is made from; steeper weights are flattened
LEAST = 0.1  # over the number of components, the share of each at least: what few draws have met must not be forgotten
# How far the log density falls in four standard deviations where it is normal, by how much another fall counts as even,
# and to where a ridge is followed: a normal law falls by that in 4.1 standard deviations.
NORMAL_FALL, EVEN, FALL = 8.0, 2.0, 8.5
RIDGE = 2.0 ** np.arange(1, 7)  # standard deviations from the top at which a ridge is looked for
COVERED = 1.0  # by how much a ridge may be higher than the components so far tell, in logarithms beside the top
NUDGE = 1e-3  # standard deviations, for the slopes beside a ridge


@dataclass(frozen=True, eq=False)
class Proposal:
    """Mixture of multivariate t laws in the unbounded space."""

    weights: FloatArray  # shape (k,): shares, adding up to 1
    means: FloatArray  # shape (k, d): centres
    roots: FloatArray  # shape (k, d, d): roots R of the scale matrices R R^T
    # effective share of importance draws, 0 to 1, in the last round that it was fitted to: how much it resembles the
    # posterior
    efficiency: float

    def draw(self, n: int, rng: np.random.Generator | np.random.RandomState) -> FloatArray:
        """Draw n points, shape (n, d)."""
        k = rng.choice(self.weights.size, size=n, p=self.weights)
        z = rng.standard_normal((n, self.means.shape[1]))
        stretch = np.sqrt(TAIL / rng.chisquare(TAIL, size=n))
        return np.asarray(self.means[k] + stretch[:, None] * np.einsum("nij,nj->ni", self.roots[k], z))

    @cached_property
    def _inverses(self) -> FloatArray:
        """Inverses of the roots, transposed, shape (k, d, d)."""
        return np.ascontiguousarray(np.linalg.inv(self.roots).transpose(0, 2, 1))

    def distances(self, z: FloatArray) -> FloatArray:
        """Squared distances from each centre in units of its scale, shape (n, k)."""
        return np.asarray(np.sum(((z - self.means[:, None]) @ self._inverses) ** 2, axis=2).T)

    def log_components(self, z: FloatArray) -> FloatArray:
        """Log of share times density of each component, shape (n, k)."""
        d = self.means.shape[1]
        constant = math.lgamma((TAIL + d) / 2) - math.lgamma(TAIL / 2) - 0.5 * d * math.log(TAIL * math.pi)
        scale = np.linalg.slogdet(self.roots)[1]
        body = -0.5 * (TAIL + d) * np.log1p(self.distances(z) / TAIL)
        return np.asarray(body + constant - scale + np.log(self.weights))

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (n, d), shape (n,)."""
        return np.asarray(logsumexp(self.log_components(z), axis=1))

    def move(self, z: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Propose for all walkers at once, as `emcee.moves.MHMove` wants it: new points and log q(old) - log q(new)."""
        new = self.draw(z.shape[0], random)
        return new, self.log_density(z) - self.log_density(new)


def fit_proposal(density: Density, start: Start, rng: np.random.Generator) -> Proposal:
    """Fit the mixture to the posterior, round by round, starting from the Gaussian around the most probable point.

    Each round draws from the present mixture and moves its components to where the importance weights of all draws so
    far are (population Monte Carlo for mixtures: Cappe, Douc, Guillin, Marin and Robert 2008, Statistics and Computing
    18, 447-459; with all draws: Cornuet, Marin, Mira and Robert 2012, Scandinavian Journal of Statistics 39, 798-812).
    """
    d = start.free.size
    made, points, heights = [_first(density, start)], np.empty((0, d)), np.empty(0)
    for n in range(1, N_ROUNDS[1] + 1):
        z = made[-1].draw(N_DRAWS, rng)
        points = np.concatenate([points, z])
        heights = np.concatenate([heights, density.log_posterior_free(z)])
        log_weight = heights - logsumexp([proposal.log_density(points) for proposal in made], axis=0)
        if not np.isfinite(log_weight).any():
            break
        last = slice(-N_DRAWS, None)
        efficiency = _efficiency(made[-1], points[last], heights[last])
        made.append(replace(_moved(made[-1], points, _flattened(log_weight, COUNTED * d)), efficiency=efficiency))
        if n >= N_ROUNDS[0] and efficiency > GOOD:
            break
    return made[-1]


def _first(density: Density, start: Start) -> Proposal:
    """Gaussians around the top, and a row of them along each ridge that reaches farther than the curvature tells.

    The curvature says nothing of a parameter that the data bound on one side only: a knee sharper than the sampling
    rate resolves, a slack that may be none, a white noise that noise of a short memory may be all of. Its ridge may be
    twenty standard deviations long and bend, and components around the top never met it.
    """
    root = root_of(start.covariance)
    weights, means, roots = [0.7, 0.3], [start.free, start.free], [root, 1.5 * root]
    for i, row in enumerate(root):  # in the whitened space, the direction in which this parameter grows, others follow
        along = root @ row / np.linalg.norm(row)
        falls = start.log_posterior - density.log_posterior_free(start.free + np.outer([4.0, -4.0], along))
        if np.all(np.abs(falls - NORMAL_FALL) < 0.5 * EVEN):
            continue
        for side in (1.0, -1.0):
            points, heights, across = _ridge(density, start, i, side)
            if len(points) < 3 or heights[2] < start.log_posterior - NORMAL_FALL + EVEN:
                continue
            known = _mixture(weights, means, roots).log_density(np.array(points))
            known += heights[0] - known[0]
            before, after = points[:-1], [*points[2:], 2.0 * points[-1] - points[-2]]
            for n, (a, b) in enumerate(zip(before, after, strict=True), start=1):
                if heights[n] < known[n] + COVERED:  # another parameter's ridge is the same
                    continue
                step = 0.3 * (b - a)
                mass = np.exp(min(heights[n] - start.log_posterior, 0.0)) * abs(step[i]) / np.linalg.norm(row)
                weights.append(max(float(mass), 0.02))  # so that the rounds meet it
                means.append(points[n])
                roots.append(root_of(across + np.outer(step, step)))
    return _mixture(weights, means, roots)


def _mixture(weights: ArrayLike, means: ArrayLike, roots: ArrayLike) -> Proposal:
    """Components in proportion to their weights, not yet held against the posterior."""
    return Proposal(np.array(weights) / np.sum(weights), np.array(means), np.array(roots), 0.0)


def _ridge(density: Density, start: Start, i: int, side: float) -> tuple[list[FloatArray], list[float], FloatArray]:
    """Follow the highest points for values of one parameter to one side of the top, until they are low.

    Gives the points, from the top, their heights, and the covariance across the ridge at the top, shape (d, d), 0 in
    the parameter's row and column.
    """
    covariance = start.covariance
    others = np.arange(start.free.size) != i
    slope = covariance[:, i] / covariance[i, i]
    across = covariance - np.outer(covariance[:, i], slope)
    root = root_of(across[np.ix_(others, others)])
    nudges = NUDGE * np.vstack([np.zeros(len(root)), np.eye(len(root))])

    def downhill(u: FloatArray, foot: FloatArray) -> tuple[float, FloatArray]:
        z = np.tile(foot, (len(nudges), 1))
        z[:, others] += (u + nudges) @ root.T
        height = density.log_posterior_free(z)
        if not np.isfinite(height).all():
            return math.inf, 0.0 * u
        return -float(height[0]), (height[0] - height[1:]) / NUDGE

    points, heights = [start.free], [start.log_posterior]
    for away in side * np.sqrt(covariance[i, i]) * RIDGE:
        foot = points[-1] + (slope * away if len(points) == 1 else 0.0)
        foot[i] = start.free[i] + away
        found = minimize(downhill, np.zeros(len(root)), (foot,), "BFGS", jac=True, options={"maxiter": 8, "gtol": 0.1})
        if not -found.fun > start.log_posterior - FALL:
            break
        foot[others] += root @ found.x
        points.append(foot)
        heights.append(-float(found.fun))
    return points, heights, across


def _flattened(log_weight: FloatArray, wanted: float) -> FloatArray:
    """Give weights that add up to 1, to a power of at most 1 at which at least `wanted` draws count.

    Where the start is much narrower or wider than the posterior, one draw would else carry all the weight.
    """
    log_weight = log_weight - np.max(log_weight)
    power = 1.0
    for _ in range(30):
        weight = np.exp(power * log_weight)
        weight /= weight.sum()
        if 1.0 / np.sum(weight**2) >= min(wanted, 0.5 * np.count_nonzero(weight)):
            break
        power *= 0.8
    return np.asarray(weight)


def _efficiency(proposal: Proposal, z: FloatArray, height: FloatArray) -> float:
    """Effective share of draws from a proposal at which the log posterior is `height`."""
    log_weight = height - proposal.log_density(z)
    if not np.isfinite(log_weight).any():
        return 0.0
    weight = np.exp(log_weight - np.max(log_weight))
    return float(np.sum(weight) ** 2 / np.sum(weight**2) / weight.size)


def _moved(proposal: Proposal, z: FloatArray, weight: FloatArray) -> Proposal:
    """One step of weighted expectation-maximisation; the fewer draws a component has, the more of it stays."""
    d = z.shape[1]
    parts = proposal.log_components(z)
    belongs = weight[:, None] * np.exp(parts - logsumexp(parts, axis=1, keepdims=True))
    pull = belongs * (TAIL + d) / (TAIL + proposal.distances(z))
    shares, means, roots = belongs.sum(axis=0), proposal.means.copy(), proposal.roots.copy()
    counted = shares**2 / np.maximum(np.sum(belongs**2, axis=0), 1e-300)
    for k in np.flatnonzero(counted > 2.0 * d):
        memory = 2.0 * d / (2.0 * d + counted[k])
        mean = pull[:, k] @ z / pull[:, k].sum()
        scatter = (z - mean).T @ ((z - mean) * pull[:, k][:, None]) / shares[k]
        before = roots[k] @ roots[k].T
        means[k] += (1 - memory) * (mean - means[k])
        roots[k] = np.linalg.cholesky((1 - memory) * scatter + memory * before)
    return _mixture(np.maximum(shares, LEAST / shares.size), means, roots)
