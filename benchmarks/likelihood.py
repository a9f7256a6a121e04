"""Time of one likelihood on averages and on all samples, as the sampling rate grows.

Run ``python benchmarks/likelihood.py`` (two minutes; ``--rates 20 1000``). Both runs of Table 1, one processor, a batch
of 22 parameter sets around the top as an ensemble holds them; the time is that of one set. What the averages change in
the posterior is in ``reduction.py``.
"""

from __future__ import annotations

import argparse
import time
from itertools import product

import numpy as np
from devices import device, n_samples
from timing import best

from shj_bayes.inference.start import find_start
from shj_bayes.model.noise import noise_models

N_SETS = 22


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[10.0, 100.0])
    parser.add_argument("--noise", nargs="+", default=["slow"], choices=list(noise_models()))
    options = parser.parse_args()
    print("noise        beta  samples  averages  averages, us  samples, us  ratio  per own at first rate  averaging, s")
    for noise, beta in product(options.noise, options.beta):
        first = 0.0
        for rate in options.rates:
            posterior, start = find_start(device(rate, beta, noise=noise))
            begin = time.thread_time()
            posterior = posterior.refined(start.free)
            prepared = time.thread_time() - begin
            whole = posterior.refined(start.free, longest_s=0.0)
            spread = np.random.default_rng(1).multivariate_normal(start.free, start.covariance, N_SETS)
            theta = posterior.model.laws.natural(spread)
            own = best(lambda p=posterior, t=theta: p.log_likelihood(t), 20) / N_SETS  # type: ignore[misc]
            every = best(lambda p=whole, t=theta: p.log_likelihood(t), 3) / N_SETS  # type: ignore[misc]
            first = first or own
            print(
                f"{noise:12} {beta:4g} {n_samples(posterior):8d} {posterior.blocks.used.size:9d} {1e6 * own:14.1f} "
                f"{1e6 * every:12.1f} {every / own:6.1f} {own / first:22.1f} {prepared:13.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
