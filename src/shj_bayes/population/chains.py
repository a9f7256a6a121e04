"""Have the chains met? Rank-normalised split R-hat and bulk effective sample size (Vehtari et al. 2021)."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from shj_bayes.population.quantities import FloatArray


def _split_normal_scores(chains: FloatArray) -> FloatArray:
    half = chains.shape[1] // 2
    split = np.concatenate([chains[:, :half], chains[:, -half:]])
    rank = rankdata(split, method="average").reshape(split.shape)
    return np.asarray(ndtri((rank - 0.375) / (split.size + 0.25)), dtype=np.float64)


def r_hat(chains: FloatArray) -> float:
    """Rank-normalised split R-hat of independent chains.

    Parameters
    ----------
    chains : array, shape (n_chains, n_draws)
        One scalar.

    Returns
    -------
    float
        1 when the chains agree; NaN when the scalar never moves.
    """
    z = _split_normal_scores(chains)
    n = z.shape[1]
    within = z.var(axis=1, ddof=1).mean()
    between = n * z.mean(axis=1).var(ddof=1)
    return float(np.sqrt(((n - 1) / n * within + between / n) / within)) if within > 0 else float("nan")


def ess_bulk(chains: FloatArray) -> float:
    """Bulk effective sample size, autocorrelations cut by Geyer's initial monotone sequence.

    Parameters
    ----------
    chains : array, shape (n_chains, n_draws)
        One scalar.

    Returns
    -------
    float
        Number of independent draws that would say as much about the middle of the distribution.
    """
    z = _split_normal_scores(chains)
    m, n = z.shape
    centred = z - z.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1)
    if within <= 0:
        return float("nan")
    total = within * (n - 1) / n + z.mean(axis=1).var(ddof=1)
    rho = 1.0 - (within - covariance * n / (n - 1)) / total
    rho[0] = 1.0
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs < 0)
    pairs = np.minimum.accumulate(pairs[: negative[0] if negative.size else pairs.size])
    tau = max(-1.0 + 2.0 * pairs.sum(), 1.0 / np.log10(m * n))
    return float(m * n / tau)
