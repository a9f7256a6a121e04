"""Time of one likelihood by sums over blocks and by samples, as the sampling rate grows, and how far they differ.

Run ``python benchmarks/likelihood.py`` (two minutes; ``--rates 20 1000``). Both runs of Table 1, one processor, a batch
of 22 parameter sets around the truth as an ensemble holds them; the time is that of one set.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from devices import device
from timing import best

N_SETS = 22


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[10.0, 100.0])
    parser.add_argument("--noise", nargs="+", default=["ar1", "independent"], choices=["ar1", "independent"])
    options = parser.parse_args()
    print("noise        beta  samples   sums, us  samples, us  ratio  per own at first rate  precompute, s  differ by")
    for noise in options.noise:
        for beta in options.beta:
            first = 0.0
            for rate in options.rates:
                problem = device(rate, beta, noise=noise)
                values = {"K": 18.0, "Fy": 80.0, "beta": beta, "gamma": 1 / 60, "ratio": 0.875, "sigma": 1.0}
                truth = np.array([values.get(n, 0.8 ** (20.0 / rate)) for n in problem.layout.names])
                theta = truth * (1 + 0.002 * np.random.default_rng(1).standard_normal((N_SETS, truth.size)))
                theta = np.minimum(theta, [np.inf if n != "phi" else 0.9999 for n in problem.layout.names])
                problem.log_likelihood(device(6.0, beta, noise=noise).natural(np.zeros((1, truth.size))))  # compiled
                begin = time.thread_time()
                for run in problem.runs:
                    vars(run).pop("moments", None)
                    _ = run.moments
                prepared = time.thread_time() - begin
                n = sum(run.recording.n_samples for run in problem.runs)
                repeats = 20 if n < 1e5 else 4
                by_sums = best(lambda p=problem, t=theta: p.log_likelihood(t), repeats) / N_SETS  # type: ignore[misc]
                by_samples = (
                    best(lambda p=problem, t=theta: p.log_likelihood_by_samples(t), max(2, repeats // 4)) / N_SETS  # type: ignore[misc]
                )
                first = first or by_sums
                gap = np.abs(problem.log_likelihood(theta) / problem.log_likelihood_by_samples(theta) - 1).max()
                print(
                    f"{noise:12} {beta:4g} {n:8d} {1e6 * by_sums:10.1f} {1e6 * by_samples:12.1f} "
                    f"{by_samples / by_sums:6.1f} {by_sums / first:22.1f} {prepared:14.3f} {gap:10.1e}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
