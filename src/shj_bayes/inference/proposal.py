"""A fixed proposal that resembles the posterior: Student-t components fitted by adaptive importance sampling."""

from dataclasses import dataclass, replace
from math import lgamma, log, pi

import numpy as np
from scipy.special import logsumexp

from shj_bayes.inference.posterior import Density
from shj_bayes.inference.start import Start, root_of
from shj_bayes.model.parameters import FloatArray

TAIL = 5.0  # degrees of freedom: a knee that is bounded from below, or noise without a slow part, has long tails
N_ROUNDS, N_DRAWS = (3, 14), 512  # rounds at least and at most
GOOD = 0.6  # efficiency with which the rounds end
COUNTED = 8.0  # effective draws per parameter that a fit is made from; steeper weights are flattened
LEAST = 0.02  # share below which a component is given up
FALL = 8.5  # a normal law falls by this in 4.1 standard deviations; a long tail 6 below the top holds much of the mass


@dataclass(frozen=True, eq=False)
class Proposal:
    """Mixture of multivariate t laws in the unbounded space."""

    weights: FloatArray  # shape (k,): shares, adding up to 1
    means: FloatArray  # shape (k, d): centres
    roots: FloatArray  # shape (k, d, d): lower Cholesky factors of the scale matrices
    # effective share of importance draws, 0 to 1, in the last round that it was fitted to: how much it resembles the
    # posterior
    efficiency: float

    def draw(self, n: int, rng: np.random.Generator | np.random.RandomState) -> FloatArray:
        """Draw n points, shape (n, d)."""
        k = rng.choice(self.weights.size, size=n, p=self.weights)
        z = rng.standard_normal((n, self.means.shape[1]))
        stretch = np.sqrt(TAIL / rng.chisquare(TAIL, size=n))
        return np.asarray(self.means[k] + stretch[:, None] * np.einsum("nij,nj->ni", self.roots[k], z))

    def distances(self, z: FloatArray) -> FloatArray:
        """Squared distances from each centre in units of its scale, shape (n, k)."""
        columns = [
            np.sum(np.linalg.solve(root, (z - mean).T) ** 2, axis=0)
            for mean, root in zip(self.means, self.roots, strict=True)
        ]
        return np.stack(columns, axis=1)

    def log_components(self, z: FloatArray) -> FloatArray:
        """Log of share times density of each component, shape (n, k)."""
        d = self.means.shape[1]
        constant = lgamma((TAIL + d) / 2) - lgamma(TAIL / 2) - 0.5 * d * log(TAIL * pi)
        scale = np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)
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
    Nothing of it enters the posterior: a poor proposal only slows the sampler down.
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
    """Gaussians around the top, and one along each parameter whose tail is longer than the curvature tells.

    The curvature says nothing of a parameter that the data bound on one side only (a knee sharper than the sampling
    rate resolves): its tail may be twenty standard deviations long, and components of the same shape never met it.
    """
    d = start.free.size
    root = root_of(start.covariance)
    weights, means, roots = [0.7, 0.3], [start.free, start.free], [root, 1.5 * root]
    distance = 2.0 ** np.arange(1, 8)
    for row in root:  # in the whitened space, the direction in which this parameter grows and the others follow
        along = row / np.linalg.norm(row)
        steps = np.concatenate([distance, -distance])
        height = density.log_posterior_free(start.free + np.outer(steps, root @ along))
        held = np.cumprod((height > start.log_posterior - FALL).reshape(2, -1), axis=1).sum(axis=1)
        up, down = 2.0**held  # farthest step on each side up to which it has not fallen
        if up + down <= 8.0:
            continue
        wide = (up + down) / 6.0
        weights.append(0.5)
        means.append(start.free + 0.5 * (up - down) * (root @ along))
        roots.append(root @ np.linalg.cholesky(np.eye(d) + (wide**2 - 1.0) * np.outer(along, along)))
    return Proposal(np.array(weights) / np.sum(weights), np.array(means), np.array(roots), 0.0)


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
    """One step of weighted expectation-maximisation, shrunk a little towards what was, as the draws are few."""
    d = z.shape[1]
    parts = proposal.log_components(z)
    belongs = weight[:, None] * np.exp(parts - logsumexp(parts, axis=1, keepdims=True))
    pull = belongs * (TAIL + d) / (TAIL + proposal.distances(z))
    memory = 2.0 * d / (2.0 * d + 1.0 / np.sum(weight**2))
    weights, means, roots = [], [], []
    for k in range(proposal.weights.size):
        share = float(belongs[:, k].sum())
        if share < LEAST:
            continue
        mean = pull[:, k] @ z / pull[:, k].sum()
        scatter = (z - mean).T @ ((z - mean) * pull[:, k][:, None]) / share
        before = proposal.roots[k] @ proposal.roots[k].T
        weights.append(share)
        means.append(mean)
        roots.append(np.linalg.cholesky((1 - memory) * scatter + memory * before))
    total = np.array(weights) / np.sum(weights)
    return Proposal(total, np.array(means), np.array(roots), 0.0)
