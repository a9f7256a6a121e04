"""From the start to a verdict: seconds of a fit of a simulated device, and how its evaluations are spent.

Run ``python benchmarks/fits.py`` (two minutes; ``--rates 20`` for the first line alone). Compiled code is warm. "to the
verdict" is the search for the top, the fit of the proposal and the sampling until R-hat < 1.01, ESS >= 1000 and more
than 50 autocorrelation times for every parameter. Wall time is what this machine took with the work it had besides;
processor time is the sum over threads.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from devices import device
from shj_bayes.inference.problem import Problem

from shj_bayes.inference.convergence import judge
from shj_bayes.inference.sampler import Plan, run_ensembles
from shj_bayes.inference.start import find_start
from shj_bayes.model.parameters import FloatArray


class Counted:
    """A density that counts its evaluations."""

    def __init__(self, problem: Problem) -> None:
        """Begin at zero."""
        self.problem, self.n = problem, 0

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Count, and evaluate."""
        self.n += z.shape[0]
        return self.problem.log_posterior_free(z)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 1000.0], help="Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[10.0, 100.0])
    parser.add_argument("--threads", type=int, default=0, help="0: one per processor")
    options = parser.parse_args()
    find_start(device(6.0, 10.0))  # compiled
    print("samples  beta  wall, s (start + sampling)  processor, s  verdict   steps   tau  ESS   evaluations  per draw")
    for rate in options.rates:
        for beta in options.beta:
            problem = device(rate, beta)
            names = problem.layout.names
            begin, used = time.perf_counter(), time.process_time()
            start = find_start(problem)
            searched = time.perf_counter() - begin
            density = Counted(problem)
            _, figures = run_ensembles(density, names, start, Plan(), threads=options.threads)
            wall, used = time.perf_counter() - begin, time.process_time() - used
            n = sum(run.recording.n_samples for run in problem.runs)
            least = float(np.min(figures.ess_bulk))
            print(
                f"{n:7d}  {beta:4g}  {wall:7.2f} ({searched:.2f} + {wall - searched:.2f})        {used:12.2f}  "
                f"{judge(figures).word:9} {figures.n_steps + figures.n_burn:4d} {figures.tau.max():6.2f} {least:5.0f} "
                f"{density.n:12d} {density.n / least:9.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
