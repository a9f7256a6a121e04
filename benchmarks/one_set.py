"""A single set of devices by quadrature, and how many new devices lie below its 5 %: ``python benchmarks/one_set.py``.

The same model as the sampler's, exact for normal errors (``tests/oracle/test_one_set.py`` holds the two together).

With one set the level of all sets is free next to it, so that its own level has a flat prior; what is left of the
hierarchy is the prior of its spread, averaged over the typical spread and over how unequal sets are.
"""

from __future__ import annotations

import argparse
from functools import cache

import numpy as np
from scipy.special import logsumexp, ndtr
from scipy.stats import norm

from shj_bayes._util.arrays import FloatArray
from shj_bayes.population.quantities import PopulationPrior, other_priors, population_prior

LOG_SPREADS = np.linspace(np.log(1e-4), np.log(30.0), 64)
AT = (np.arange(200) + 0.5) / 200
"""Probabilities at which the predictive distribution is given."""
N_FORCES = 200


@cache
def prior_of_spread(prior: PopulationPrior) -> FloatArray:
    """Log density of the spread of one set at ``LOG_SPREADS``."""
    unequal = prior.unequal_scale * norm.isf(0.5 * (1.0 - (np.arange(200) + 0.5) / 200))
    centre = np.log(prior.spread_median)
    if prior.spread_log_sd > 0:
        sd = np.hypot(prior.spread_log_sd, unequal)
        density = norm.pdf(LOG_SPREADS[:, None], centre, sd).mean(axis=1)
    else:  # half-Cauchy: its quantiles
        typical = centre + np.log(np.tan(0.5 * np.pi * (np.arange(1000) + 0.5) / 1000))
        gap = LOG_SPREADS[:, None, None] - typical[None, :, None]
        density = norm.pdf(gap, 0.0, unequal[None, None, ::10]).mean(axis=(1, 2))
    return np.asarray(np.log(np.maximum(density, 1e-300)))


def draws_of_one_set(
    values: FloatArray, errors: FloatArray, prior: PopulationPrior, *, read: bool = True
) -> FloatArray:
    """Evenly spaced quantiles of a new device as its own test would show it, pooled scale.

    Parameters
    ----------
    values, errors : array, shape (n,)
        Devices and the standard deviation with which each is known, pooled scale.
    prior : PopulationPrior
        Of the quantity.
    read : bool
        Whether the new device carries the error of its reading as the tested ones do.

    Returns
    -------
    array, shape (200,)
        At the probabilities ``AT``.
    """
    weight, level, spread, sd_level, squared = _posterior(values, errors, prior)
    sd = np.sqrt(spread**2 + sd_level**2 + read * squared)
    middle = float(weight @ level)
    inside = np.linspace(-6.0, 6.0, N_FORCES)
    scale = float(np.exp(weight @ np.log(sd)))
    grid = middle + scale * np.sinh(inside) / 4.0
    share = weight @ ndtr((grid - level[:, None]) / sd[:, None])
    return np.asarray(np.interp(AT, share, grid))


def level_and_spread(
    values: FloatArray, errors: FloatArray, prior: PopulationPrior, n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw level and spread of the set together, each of shape (n,); arguments as for `draws_of_one_set`."""
    weight, level, spread, sd_level, _ = _posterior(values, errors, prior)
    chosen = rng.choice(weight.size, n, p=weight)
    return level[chosen] + sd_level[chosen] * rng.standard_normal(n), spread[chosen]


def _posterior(values: FloatArray, errors: FloatArray, prior: PopulationPrior) -> tuple[FloatArray, ...]:
    """Weight of each spread, level, the spread, standard deviation of the level, mean square of the errors."""
    spread = np.exp(LOG_SPREADS)[:, None]
    precision = 1.0 / (spread**2 + errors**2)
    total = precision.sum(axis=1)
    level = precision @ values / total
    squares = np.sum(precision * (values - level[:, None]) ** 2, axis=1)
    log_weight = 0.5 * np.log(precision).sum(axis=1) - 0.5 * np.log(total) - 0.5 * squares + prior_of_spread(prior)
    weight = np.exp(log_weight - logsumexp(log_weight))
    kept = weight > 1e-9
    weight = weight[kept] / weight[kept].sum()
    return weight, level[kept], spread[kept, 0], 1.0 / np.sqrt(total[kept]), np.array(np.mean(errors**2))


def below(n: int, spread: float, error: float, campaigns: int, seed: int) -> dict[str, float]:
    """Mean share of new devices below the 5 % end, per cent, by prior of the spread; outermost of all last."""
    main = population_prior("least")
    priors = {"default": main, **other_priors(main)}
    rng = np.random.default_rng(seed)
    out: dict[str, list[float]] = {}
    for _ in range(campaigns):
        y = spread * rng.standard_normal(n) + error * rng.standard_normal(n)
        for read, words in ((False, "not read"), (True, "read")):
            ends = {
                label: float(np.quantile(draws_of_one_set(y, np.full(n, error), prior, read=read), 0.05))
                for label, prior in priors.items()
            }
            for label, end in (*ends.items(), ("outermost", min(ends.values()))):
                out.setdefault(f"{label}, {words}", []).append(float(ndtr(end / spread)))
    return {label: 100.0 * float(np.mean(shares)) for label, shares in out.items()}


def main() -> None:
    """Print shares of new devices below the 5 % end of their set."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-n", type=int, default=250, help="campaigns (250)")
    parser.add_argument("--seed", type=int, default=5)
    asked = parser.parse_args()
    for n in (3, 6):
        for error in (0.01, 0.03):
            shares = below(n, 0.10, error, asked.n, asked.seed)
            print(f"{n} devices, spread 0.10, error {error}: " + "; ".join(f"{k} {v:.1f} %" for k, v in shares.items()))


if __name__ == "__main__":
    main()
