"""From the start to a verdict: seconds of a fit of a simulated device, and how its evaluations are spent.

Run ``python benchmarks/fits.py`` (a minute; ``--rates 20`` for the first line alone, ``--effects slack wear`` for one
fit more with each of these effects in the model). Compiled code is warm. "to the verdict" is the averaging, the search
for the top, the fit of the proposal and the sampling until R-hat < 1.01, ESS >= 1000 and more than 50 autocorrelation
times for every parameter. Wall time is what this machine took with the work it had besides; processor time is the sum
over threads.
"""

from __future__ import annotations

import argparse
import time
from itertools import product

import numpy as np
from devices import device, n_samples
from timing import Counted

from shj_bayes.inference.convergence import judge
from shj_bayes.inference.likelihood import make_likelihood
from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import find_start


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[10.0, 100.0])
    parser.add_argument("--effects", nargs="+", default=[], help="effects to fit too, one after the other")
    parser.add_argument("--threads", type=int, default=0, help="0: one per processor")
    options = parser.parse_args()
    find_start(device(6.0, 10.0, effects=options.effects))  # compiled
    print("samples  averages  beta  effect            wall, s (start + sampling)  processor, s  ", end="")
    print("verdict   steps    tau   ESS  evaluations  per draw")
    for rate, beta, effect in product(options.rates, options.beta, ["", *options.effects]):
        given = device(rate, beta, effects=[effect] if effect else [])
        begin, used = time.perf_counter(), time.process_time()
        posterior, start = find_start(make_likelihood(given.runs, given.model), threads=options.threads)
        searched = time.perf_counter() - begin
        density = Counted(posterior)
        _, figures = run_ensembles(density, posterior.model.names, start, SamplingPlan(threads=options.threads))
        wall, used = time.perf_counter() - begin, time.process_time() - used
        least = float(np.min(figures.ess_bulk))
        n_blocks = posterior.blocks.used.size
        print(
            f"{n_samples(posterior):7d}  {n_blocks:8d}  {beta:4g}  {effect or 'none':16}  {wall:7.2f} "
            f"({searched:.2f} + {wall - searched:.2f})       {used:12.2f}  {judge(figures).word:9} "
            f"{figures.n_steps + figures.n_burn:4d} {figures.tau.max():6.2f} {least:5.0f} {density.n:12d} "
            f"{density.n / least:9.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
