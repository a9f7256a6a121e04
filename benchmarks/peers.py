"""The same posterior by other samplers, side by side in one run: seconds, evaluations, and whether they are right.

Run ``python benchmarks/peers.py`` (half an hour; ``--only NAME ...`` takes some). Every peer samples the device of
``devices.py`` at 20 Hz with the same law, noise model and priors: all samples, with the numpy likelihood of
``numpy_posterior.py`` (NumPyro with law and Kalman filter in JAX), started from the most probable point where it takes
a start, until R-hat < 1.01 over four chains or ensembles and ESS >= 1000 for every parameter, or its own stop.
A time counts only if all means are within 0.1 standard deviations of the reference and all standard deviations within
3 % and three Monte-Carlo errors: the column "right" says so. The reference is a run of shj-bayes of 20 000 effective
draws on all samples, so that what shj-bayes loses by averaging counts against it. Judged are the parameters of the law;
how far those of the noise are off is in the last column.

Seconds are processor time, all threads together, so that other work does not count, and wall time, which says what two
processors are worth. numpy is held to one thread: its vector products here are too short for more, and the threads that
wait would count against it.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from devices import device, n_samples
from numpy_posterior import NumpyPosterior
from samplers import N_LAW, SAMPLERS, Draws, reference
from threadpoolctl import threadpool_limits

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.start import find_start, polish

LOST = (ImportError, RuntimeError, OSError)  # not installed, or not for this machine


def line(name: str, draws: Draws, seconds: tuple[float, float], mean: FloatArray, sd: FloatArray) -> str:
    """One row of the table."""
    flat = draws.chains.reshape(-1, mean.size) if draws.weights is None else draws.chains
    weights = np.full(flat.shape[0], 1 / flat.shape[0]) if draws.weights is None else draws.weights
    own = weights @ flat
    off = np.abs(own - mean) / sd
    width = np.sqrt(weights @ (flat - own) ** 2) / sd
    note = f"{draws.note}; noise off by {off[N_LAW:].max():.2f}, sd to {width[N_LAW:].max():.2f}"
    off, width = off[:N_LAW], width[:N_LAW]
    right = off.max() < 0.1 and np.all(np.abs(width - 1) < 0.03 + 3 / np.sqrt(2 * draws.ess))
    return (
        f"{name:38s} {seconds[0]:9.2f} {seconds[1]:8.2f} {draws.evaluations:12d}"
        f" {draws.ess:8.0f} {draws.evaluations / draws.ess:9.1f}"
        f" {off.max():11.2f} {width.min():7.3f} {width.max():6.3f}  {'yes' if right else 'NO':4s} {note}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", nargs="+", default=list(SAMPLERS), choices=list(SAMPLERS))
    parser.add_argument("--beta", type=float, nargs="+", default=[10.0])
    options = parser.parse_args()
    for beta in options.beta:
        first = device(20.0, beta)
        _, start = find_start(first)
        whole = first.refined(start.free, longest_s=0.0)
        start = polish(whole, [start.free])
        gap = NumpyPosterior(first)(start.free) - whole.log_posterior_free(start.free[None])[0]
        assert abs(gap) < 1e-6, gap
        flat = reference(whole, start).reshape(-1, start.free.size)
        mean, sd = flat.mean(axis=0), flat.std(axis=0)
        print(f"beta {beta:g}, {n_samples(first)} samples, {mean.size} parameters")
        print(f"{'':38s} processor     wall  evaluations      ESS  per draw  mean off by  sd from    to  right")
        for name in options.only:
            try:
                peer, begin = NumpyPosterior(first), (time.process_time(), time.perf_counter())
                with threadpool_limits(1, user_api="blas"):
                    draws = SAMPLERS[name](first, peer, start)
                seconds = time.process_time() - begin[0], time.perf_counter() - begin[1]
            except LOST as error:
                print(f"{name:38s} not run: {error}", flush=True)
                continue
            print(line(name, draws, seconds, mean, sd), flush=True)


if __name__ == "__main__":
    main()
