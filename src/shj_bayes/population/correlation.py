"""How K, Fy, ratio, gamma and beta go together from device to device of a set.

Quantities are pooled one by one; this joins them. Devices are standardised with the level of their own set and its
spread, and the correlation of what is left is inferred with an inverse-Wishart law whose correlations are uniform on
(-1, 1) before any device is seen (Barnard, McCulloch and Meng 2000). A new device is then drawn with its quantities
tied together, each with exactly the band it had by itself (a normal copula; inference in two steps, Joe and Xu 1996).
"""

import numpy as np

from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.quantities import FloatArray, band_of, stream


def scatter(result: PopulationResult, prior: str = "default") -> tuple[tuple[str, ...], FloatArray, int]:
    """Sum of squares and products of the standardised devices about their set, and its degrees of freedom.

    Names of the quantities; products over the devices that give every quantity, shape (k, k); devices less sets, 0
    where every set has one device.
    """
    names = tuple(result.posteriors)
    products, degrees = np.zeros((len(names), len(names))), 0
    spread = np.array([np.median(result.fit(q, prior).tau, axis=0) for q in names])
    for i, group in enumerate(result.sets):
        values = np.array([group.points.get(q, (np.nan,) * len(group.devices)) for q in names])
        values = values[:, np.all(np.isfinite(values), axis=0)]
        if values.shape[1] < 2:
            continue
        apart = (values - values.mean(axis=1, keepdims=True)) / spread[:, i, None]
        products += apart @ apart.T
        degrees += values.shape[1] - 1
    return names, products, degrees


def inverse_wishart(degrees: float, scale: FloatArray, n_draws: int, rng: np.random.Generator) -> FloatArray:
    """Draw from an inverse Wishart distribution by the decomposition of Bartlett, shape (n_draws, k, k).

    `scipy.stats.invwishart` does so too, but its module takes longer to import than all else of a comparison, and it
    goes through the draws one by one.
    """
    k = scale.shape[0]
    roots = np.zeros((n_draws, k, k))  # lower triangles whose inverses are the factors of draws of unit scale
    roots[:, *np.tril_indices(k, k=-1)] = rng.normal(size=(n_draws, k * (k - 1) // 2))
    places = np.arange(k)
    roots[:, places, places] = np.sqrt(rng.chisquare(degrees - k + 1 + places, size=(n_draws, k)))
    factors = np.linalg.solve(roots.transpose(0, 2, 1), np.linalg.cholesky(scale).T)
    return np.asarray(factors.transpose(0, 2, 1) @ factors)


def correlation_draws(result: PopulationResult, n_draws: int, prior: str = "default") -> FloatArray:
    """Posterior draws of the correlation between the quantities of one device, shape (n_draws, k, k)."""
    names, products, degrees = scatter(result, prior)
    k = len(names)
    if k == 1:
        return np.ones((n_draws, 1, 1))
    seed = stream(result.seed, "correlation", prior)
    drawn = inverse_wishart(k + 1 + degrees, np.eye(k) + products, n_draws, np.random.default_rng(seed))
    scale = np.sqrt(np.einsum("nii->ni", drawn))
    return np.asarray(drawn / (scale[:, :, None] * scale[:, None, :]))


def correlation_table(result: PopulationResult) -> list[dict[str, object]]:
    """Middle and 90 % interval of the correlation of every pair, and on how many degrees of freedom it rests."""
    names, _, degrees = scatter(result)
    draws = correlation_draws(result, 4000)
    rows: list[dict[str, object]] = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            low, middle, high = band_of(draws[:, i, j])
            rows.append({"pair": [b, a], "q05": low, "q50": middle, "q95": high, "degrees_of_freedom": degrees})
    return rows
