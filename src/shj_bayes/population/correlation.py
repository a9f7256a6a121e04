"""How K, Fy, ratio, gamma and beta go together from device to device of a set.

Quantities are pooled one by one; this joins them. Devices are standardised with the level of their own set and its
spread, and the correlation of what is left is inferred with an inverse-Wishart law whose correlations are uniform on
(-1, 1) before any device is seen (Barnard, McCulloch and Meng 2000). A new device is then drawn with its quantities
tied together, each with exactly the band it had by itself (a normal copula; inference in two steps, Joe and Xu 1996).
"""

from __future__ import annotations

import zlib

import numpy as np

from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.quantities import FloatArray


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


def correlation_draws(result: PopulationResult, n_draws: int, prior: str = "default") -> FloatArray:
    """Posterior draws of the correlation between the quantities of one device, shape (n_draws, k, k)."""
    names, products, degrees = scatter(result, prior)
    k = len(names)
    if k == 1:
        return np.ones((n_draws, 1, 1))
    seed = np.random.SeedSequence([result.seed, zlib.crc32(b"correlation"), zlib.crc32(prior.encode())])
    from scipy import stats  # noqa: PLC0415  half a second that other summaries need not wait for

    law = stats.invwishart(df=k + 1 + degrees, scale=np.eye(k) + products)
    drawn = np.asarray(law.rvs(size=n_draws, random_state=np.random.default_rng(seed))).reshape(n_draws, k, k)
    scale = np.sqrt(np.einsum("nii->ni", drawn))
    return np.asarray(drawn / (scale[:, :, None] * scale[:, None, :]))


def correlation_table(result: PopulationResult) -> list[dict[str, object]]:
    """Middle and 90 % interval of the correlation of every pair, and on how many degrees of freedom it rests."""
    names, _, degrees = scatter(result)
    draws = correlation_draws(result, 4000)
    rows: list[dict[str, object]] = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            low, middle, high = (float(x) for x in np.quantile(draws[:, i, j], (0.05, 0.5, 0.95)))
            rows.append({"pair": [b, a], "q05": low, "q50": middle, "q95": high, "degrees_of_freedom": degrees})
    return rows
