"""How far the posterior of averaged recordings is from that of all samples: ``python benchmarks/reduction.py``.

For each sampling rate, sharpness and reversal rule the device of ``devices.py`` is averaged and sampled as a fit does
it, and once more with each sample a block of its own, which is no reduction. Printed are how far the means are apart,
in standard deviations, of the draws as sampled and as a fit weights them for all samples, and the ratio of the standard
deviations of the latter. The displacement has no noise. Two minutes; 200 Hz takes a quarter of an hour more
(``--rates 200``). Chance alone puts the means 0.02 apart. Exit status 1 where those of a fit are further than 0.05
apart (root of the mean square over a row) or a ratio further than 3 % from 1.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from devices import device, n_samples

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.fit import evenly_spread, weights_of_all_samples
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import Start, find_start, polish

NAMES = ("K", "Fy", "beta", "gamma", "ratio")
SHIFT_LIMIT, RATIO_LIMIT = 0.05, 0.03


def sampled(posterior: Likelihood, start: Start) -> FloatArray:
    """Draws of a posterior, shape (n_ensembles, n, d)."""
    states, figures = run_ensembles(posterior, posterior.model.names, start, SamplingPlan())
    return np.stack([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[5.0, 15.0, 50.0, 150.0, 300.0])
    parser.add_argument("--rules", nargs="+", default=["published", "continuous"])
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    print(f"means of {', '.join(NAMES)} apart, sd:")
    print(f"rule        beta  samples  blocks  {'averages alone':40}{'weighted':40}ratio of sds{'k':>27}")
    worst = np.zeros(2)
    for rule in options.rules:
        for rate in options.rates:
            for beta in options.beta:
                posterior, start = find_start(device(rate, beta, variant=rule, seed=options.seed), threads=0)
                draws = sampled(posterior, start)
                weights, tail = weights_of_all_samples(posterior, start, draws, threads=0)
                chosen = np.take_along_axis(draws, evenly_spread(weights)[:, :, None], axis=1)
                whole = posterior.refined(start.free, longest_s=0.0)
                right = sampled(whole, polish(whole, [start.free]))
                law = [posterior.model.names.index(name) for name in NAMES]
                flat = (some.reshape(-1, some.shape[-1]) for some in (draws, chosen, right))
                before, after, right = (posterior.model.laws.natural(some)[:, law] for some in flat)
                shifts = [(some.mean(axis=0) - right.mean(axis=0)) / right.std(axis=0) for some in (before, after)]
                ratio = after.std(axis=0) / right.std(axis=0)
                worst = np.maximum(worst, [np.sqrt(np.mean(shifts[1] ** 2)), np.abs(ratio - 1).max()])
                columns = [" ".join(f"{value:+7.3f}" for value in shift) + " " for shift in shifts]
                print(
                    f"{rule:10} {beta:5g} {n_samples(posterior):8d} {posterior.blocks.used.size:7d} {''.join(columns)}"
                    + " ".join(f"{value:6.3f}" for value in ratio)
                    + f" {tail:5.2f}",
                    flush=True,
                )
    good = bool(worst[0] <= SHIFT_LIMIT and worst[1] <= RATIO_LIMIT)
    print(f"at most {worst[0]:.3f} sd and {100 * worst[1]:.1f} % apart: {'within' if good else 'NOT within'} the aim")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
