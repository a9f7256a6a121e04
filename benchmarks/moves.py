"""Autocorrelation time and acceptance of emcee's proposals on the posterior of a simulated device.

Run ``python benchmarks/moves.py`` (about ten minutes on one processor; ``--steps 2000`` for a quick look).
One recording pair, one start, the same seeds for all; four ensembles each. ``tau`` is the longest integrated
autocorrelation time of any parameter (mean over the ensembles, standard error from their spread); ``ms per draw`` is
the wall time for one effective draw of the worst parameter, ``steps per draw`` the same without the machine.
Only proposals that pass ``tests/statistical/test_moves.py`` may be used; emcee 3.1.6's snooker move is shown for
comparison and does not.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import emcee
import numpy as np
from emcee.moves import DEMove, DESnookerMove, KDEMove, MHMove, RedBlueMove, StretchMove

from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.convergence import autocorrelation_time
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.proposal import Proposal, fit_proposal
from shj_bayes.inference.sampler import moves
from shj_bayes.inference.start import Start, find_start
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device

Mix = list[tuple[emcee.moves.Move, float]]


class ComplementMove(RedBlueMove):  # type: ignore[misc]
    """Draws from the Gaussian of the other half of the ensemble, its few points held together by the start's."""

    def __init__(self, start: Start, memory: float) -> None:
        """Let `memory` stand for that many points of the start's covariance."""
        super().__init__()
        self.start, self.memory = start, memory

    def get_proposal(
        self, sample: np.ndarray, complement: list[np.ndarray], random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Give new points and log q(old) - log q(new)."""
        others = np.concatenate(complement)
        n, m = len(others), self.memory
        spread = (n * np.cov(others.T) + m * self.start.covariance) / (n + m)
        law = Proposal(np.ones(1), others.mean(axis=0)[None], np.asarray(np.linalg.cholesky(spread))[None], 1.0)
        return law.move(sample, random)


def start_only(start: Start) -> Proposal:
    """One t law around the most probable point, with the curvature there."""
    return Proposal(np.ones(1), start.free[None], np.asarray(np.linalg.cholesky(start.covariance))[None], 1.0)


DE: Mix = [(DEMove(), 0.15), (DEMove(gamma0=1.0), 0.05)]
FITTED: dict[str, Callable[[Likelihood, Start], Mix]] = {
    "fitted mixture (shipped)": lambda posterior, start: moves(
        fit_proposal(posterior, start, np.random.default_rng(1))
    ),
    "0.8 t law at the top + 0.2 DE": lambda _, start: [(MHMove(start_only(start).move), 0.8), *DE],
    "0.8 Gaussian of the others + 0.2 DE": lambda _, start: [(ComplementMove(start, 14.0), 0.8), *DE],
}
MIXES: dict[str, Callable[[int], Mix]] = {
    "stretch": lambda d: [(StretchMove(), 1.0)],
    "DE": lambda d: [(DEMove(), 1.0)],
    "0.9 DE + 0.1 whole": lambda d: [(DEMove(), 0.9), (DEMove(gamma0=1.0), 0.1)],
    "0.7 DE + 0.3 whole": lambda d: [(DEMove(), 0.7), (DEMove(gamma0=1.0), 0.3)],
    "0.9 DE x 0.8 + 0.1 whole": lambda d: [
        (DEMove(gamma0=0.8 * 2.38 / np.sqrt(2 * d)), 0.9),
        (DEMove(gamma0=1.0), 0.1),
    ],
    "0.9 DE x 1.2 + 0.1 whole": lambda d: [
        (DEMove(gamma0=1.2 * 2.38 / np.sqrt(2 * d)), 0.9),
        (DEMove(gamma0=1.0), 0.1),
    ],
    "0.5 DE + 0.5 KDE": lambda d: [(DEMove(), 0.5), (KDEMove(), 0.5)],
    "0.8 DE + 0.2 KDE": lambda d: [(DEMove(), 0.8), (KDEMove(), 0.2)],
    "KDE": lambda d: [(KDEMove(), 1.0)],
    "0.8 DE + 0.2 snooker (biased)": lambda d: [(DEMove(), 0.8), (DESnookerMove(), 0.2)],
}


def sample(
    posterior: Likelihood, start: Start, mix: Mix, *, n_walkers: int, n_steps: int, seed: int
) -> tuple[np.ndarray, float, float]:
    """Chain after a fifth of burn-in, accepted share, and seconds per step."""
    d = start.free.size
    rng = np.random.default_rng(seed)
    points = start.free + rng.standard_normal((n_walkers, d)) @ np.linalg.cholesky(start.covariance).T
    sampler = emcee.EnsembleSampler(n_walkers, d, posterior.log_posterior_free, moves=mix, vectorize=True)
    state = emcee.State(points, random_state=np.random.RandomState(seed).get_state())
    begin = time.perf_counter()
    sampler.run_mcmc(state, n_steps)
    seconds = (time.perf_counter() - begin) / n_steps
    return sampler.get_chain()[n_steps // 5 :], float(np.mean(sampler.acceptance_fraction)), seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--rate", type=float, default=5.0, help="sampling rate of the simulated device, Hz")
    parser.add_argument("--beta", type=float, default=10.0)
    parser.add_argument("--walkers", type=int, nargs="+", default=[28])
    parser.add_argument("--only", nargs="+", default=[*FITTED, *MIXES], choices=[*FITTED, *MIXES])
    options = parser.parse_args()
    truth = Truth(beta=options.beta, gamma=1 / 60, phi=0.0, sigma_slow=0.6)
    device = runs_of(simulate_device(truth, seed=1, rate_Hz=options.rate))
    posterior, start = find_start(make_likelihood(device, DeviceModel(len(device), read_priors("afc"))))
    d = start.free.size
    print(f"{d} parameters, {options.rate:g} Hz, beta {options.beta:g}, {options.steps} steps, 4 ensembles")
    print(f"{'moves':36s} walkers  acceptance       tau        steps per draw  ms per step  ms per draw  worst")
    for name in options.only:
        mix = FITTED[name](posterior, start) if name in FITTED else MIXES[name](d)
        for n_walkers in options.walkers:
            runs = [
                sample(posterior, start, mix, n_walkers=n_walkers, n_steps=options.steps, seed=seed)
                for seed in range(1, 5)
            ]
            times = np.array([autocorrelation_time([chain]) for chain, _, _ in runs])
            worst = int(np.argmax(times.mean(axis=0)))
            tau, error = times[:, worst].mean(), times[:, worst].std(ddof=1) / 2
            step_ms = 1e3 * np.mean([seconds for *_, seconds in runs])
            print(
                f"{name:36s} {n_walkers:7d}  {np.mean([a for _, a, _ in runs]):10.3f}  {tau:6.1f} +/- {error:4.1f}"
                f"  {tau / n_walkers:14.3f}  {step_ms:11.2f}  {step_ms * tau / n_walkers:11.2f}"
                f"  {posterior.model.names[worst]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
