"""How far the posterior of averaged recordings is from that of all samples: ``python benchmarks/reduction.py``.

For each sampling rate, sharpness and reversal rule the device of ``devices.py`` is averaged as a fit does it, and once
more with each sample a block of its own, which is no reduction. Printed are, at the tops of both posteriors (Laplace),
the shift of the mean in standard deviations and the ratio of the standard deviations. The displacement has no noise.
Five minutes, most of them for the samples at 1 kHz (``--rates 20`` for a quick look). Exit status 1 where a shift is
above 0.05 or a ratio further than 3 % from 1.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from devices import device, n_samples

from shj_bayes.inference.start import find_start, polish

NAMES = ("K", "Fy", "beta", "gamma", "ratio")
SHIFT_LIMIT, RATIO_LIMIT = 0.05, 0.03


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 200.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[5.0, 15.0, 50.0, 150.0, 300.0])
    parser.add_argument("--rules", nargs="+", default=["published", "continuous"])
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    print("rule        beta  samples  blocks  mean apart, sd, of " + f"{', '.join(NAMES):32}" + "  ratio of sds")
    worst = np.zeros(2)
    for rule in options.rules:
        for rate in options.rates:
            for beta in options.beta:
                posterior, start = find_start(device(rate, beta, variant=rule, seed=options.seed), threads=0)
                whole = posterior.refined(posterior.natural(start.free[None])[0], longest_s=0.0)
                top = polish(whole, [start.free])
                law = [posterior.model.index(name) for name in NAMES]
                own, sd = (np.sqrt(np.diag(s.covariance))[law] for s in (start, top))
                shift, ratio = (start.free - top.free)[law] / sd, own / sd
                worst = np.maximum(worst, [np.abs(shift).max(), np.abs(ratio - 1).max()])
                print(
                    f"{rule:10} {beta:5g} {n_samples(posterior):8d} {posterior.n_blocks:7d}  "
                    + " ".join(f"{value:+9.3f}" for value in shift)
                    + "    "
                    + " ".join(f"{value:6.3f}" for value in ratio),
                    flush=True,
                )
    good = bool(worst[0] <= SHIFT_LIMIT and worst[1] <= RATIO_LIMIT)
    print(f"at most {worst[0]:.3f} sd and {100 * worst[1]:.1f} % apart: {'within' if good else 'NOT within'} the aim")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
