"""How far the posterior of averaged recordings is from that of all samples: ``python benchmarks/reduction.py``.

For each sampling rate, sharpness and reversal rule the device of ``devices.py`` is averaged as a fit does it, and once
more with each sample a block of its own, which is no reduction. Printed are, at the tops of both posteriors (Laplace),
the shift of the mean in standard deviations and the ratio of the standard deviations. The displacement has no noise.
Five minutes, most of them for the samples at 1 kHz (``--rates 20`` for a quick look). Exit status 1 where a shift is
above 0.05 or a ratio further than 3 % from 1.

``--averaged`` holds recordings of 1 kHz against the same averaged to 20 Hz before they were read, over four seeds. What
the knee moves within a twentieth of a second is lost in such a mean, whoever reads it, so the noise is 20 kN there,
beside which that is small; ``--noise`` takes another.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import product

import numpy as np
from devices import device, n_samples

from shj_bayes.inference.posterior import make_posterior
from shj_bayes.inference.run import Run
from shj_bayes.inference.start import find_start, polish
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.recording import Recording

AVERAGED = 50  # samples of 1 kHz in one of 20 Hz
AVERAGED_LIMIT = 0.15
NAMES = ("K", "Fy", "beta", "gamma", "ratio")
SHIFT_LIMIT, RATIO_LIMIT = 0.05, 0.03


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 200.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[5.0, 15.0, 50.0, 150.0, 300.0])
    parser.add_argument("--rules", nargs="+", default=["published", "continuous"])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--averaged", action="store_true", help="1 kHz against its own averages at 20 Hz")
    parser.add_argument("--noise", type=float, default=20.0, help="white noise of --averaged at 1 kHz, kN")
    options = parser.parse_args()
    if options.averaged:
        return against_averaged(options.beta, options.rules, options.noise)
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


def averaged(run: Run) -> Run:
    """Give a run as a slower logger would have recorded it: means of `AVERAGED` samples, none across a reversal."""
    motion = run.motion
    n = motion.displacement_mm.size // AVERAGED
    half = motion.half_cycle[: n * AVERAGED].reshape(n, AVERAGED)
    time, x, force, speed = (
        values[: n * AVERAGED].reshape(n, AVERAGED).mean(axis=1)
        for values in (run.recording.time_s, motion.displacement_mm, run.recording.force_kN, motion.speed_mm_s)
    )
    start = np.append(np.searchsorted(half[:, AVERAGED // 2], np.arange(motion.n_half)), n)
    own = Motion(x, speed, start, motion.turning_mm, motion.direction)
    return Run(Recording(time, x, force, used=half[:, 0] == half[:, -1]), own)


def against_averaged(betas: Sequence[float], rules: Sequence[str], sigma_kN: float) -> int:
    """Print how far the posteriors of recordings and of their averages are apart."""
    print("rule        beta  root mean square of the means apart, sd, and ratio of sds, of " + ", ".join(NAMES))
    worst = 0.0
    for rule, beta in product(rules, betas):
        apart, ratios = [], []
        for seed in range(4):
            fast = device(1000.0, beta, variant=rule, seed=seed, sigma_kN=sigma_kN)
            slow = make_posterior([averaged(run) for run in fast.runs], fast.model)
            law = [fast.model.index(name) for name in NAMES]
            (_, whole), (_, own) = find_start(fast), find_start(slow)
            sd, other = (np.sqrt(np.diag(start.covariance))[law] for start in (whole, own))
            apart.append((own.free - whole.free)[law] / sd)
            ratios.append(other / sd)
        size = np.sqrt(np.mean(np.square(apart), axis=0))
        worst = max(worst, float(size.max()))
        words = (" ".join(f"{value:6.3f}" for value in row) for row in (size, np.mean(ratios, axis=0)))
        print(f"{rule:10} {beta:5g}  " + "    ".join(words), flush=True)
    print(f"at most {worst:.3f} sd apart: {'within' if worst <= AVERAGED_LIMIT else 'NOT within'} the aim")
    return int(worst > AVERAGED_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
