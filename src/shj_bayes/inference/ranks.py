"""R-hat and effective sample sizes of Vehtari et al. 2021 (Bayesian Analysis 16, 667-718), without importing ArviZ.

ArviZ gives the same numbers, and the tests hold these against them; its import takes longer than sampling a device.
"""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtri

from shj_bayes.model.parameters import FloatArray

TAILS = (0.05, 0.95)


def rhat(chains: FloatArray) -> float:
    """Rank-normalised split R-hat of one scalar, the larger of bulk and folded; chains of shape (n_chains, n_draws)."""
    halves = _split(chains)
    return max(_rhat(_scores(halves)), _rhat(_scores(np.abs(halves - np.median(halves)))))


def ess_bulk(chains: FloatArray) -> float:
    """Bulk effective sample size of one scalar, chains of shape (n_chains, n_draws)."""
    return _ess(_scores(_split(chains)))


def ess_tail(chains: FloatArray) -> float:
    """Effective sample size of the 5 and 95 % quantiles, the smaller; chains of shape (n_chains, n_draws)."""
    return min(_ess(_split(chains <= edge).astype(np.float64)) for edge in np.quantile(chains, TAILS))


def _split(chains: FloatArray) -> FloatArray:
    """Halves of the chains as chains; of an odd number of draws the middle one is left out."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _scores(chains: FloatArray) -> FloatArray:
    """Turn draws into normal scores of their ranks among all; ties get their mean rank."""
    _, place, count = np.unique(chains, return_inverse=True, return_counts=True)
    rank = np.cumsum(count) - 0.5 * (count - 1.0)
    return np.asarray(ndtri((rank[place] - 0.375) / (chains.size + 0.25)).reshape(chains.shape))


def _rhat(chains: FloatArray) -> float:
    n = chains.shape[1]
    between, within = n * chains.mean(axis=1).var(ddof=1), chains.var(axis=1, ddof=1).mean()
    return float(np.sqrt((between / within + n - 1) / n))


def _ess(chains: FloatArray) -> float:
    """Effective sample size by Geyer's initial monotone sequence."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    n_chains, n = chains.shape
    spectrum = np.abs(rfft(chains - chains.mean(axis=1, keepdims=True), next_fast_len(2 * n), axis=1)) ** 2
    covariance = irfft(spectrum, next_fast_len(2 * n), axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1.0)
    total = covariance[0] + (chains.mean(axis=1).var(ddof=1) if n_chains > 1 else 0.0)
    rho = 1.0 - (within - covariance) / total
    rho[0] = 1.0
    even, odd = rho[0 : n // 2 * 2 : 2], rho[1 : n // 2 * 2 : 2]
    last = max(0, (n - 3) // 2)  # the last pair that is looked at, or the first that is not above 0
    negative = np.flatnonzero(even[: last + 1] + odd[: last + 1] <= 0)
    last = min(last, int(negative[0])) if negative.size else last
    pairs = np.minimum.accumulate((even + odd)[:last])
    rest = even[last] if even[last] > 0 or even[last] + odd[last] >= 0 else 0.0
    tau = max(-1.0 + 2.0 * float(pairs.sum()) + float(rest), 1.0 / np.log10(chains.size))
    return float(chains.size / tau)
