"""What the noise of the displacement adds to a posterior that takes the displacement for exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.inference.checkpoint import EnsembleState
from shj_bayes.inference.problem import Problem, Run
from shj_bayes.inference.start import Start, polish
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.recording import Recording

N_COPIES = 8  # histories that are drawn
N_SAMPLES = 6000  # of each run of a copy; noise of the mean of as many samples as were left out goes with them
# K times the displacement's noise over sigma. Below it the sampled intervals held the truth as often as they say; above
# it 66 % of 90 % intervals of K did, of 97 simulated devices (docs/decisions/0009).
MATTERS = 0.5


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How the most probable parameters depend on which of the possible displacements was the true one.

    Parameters
    ----------
    ratio : float
        K times the noise of the displacement over that of the force.
    noise_mm : float
        Noise of the displacement, mm.
    moves : array, shape (n_copies, d)
        Most probable parameters of each drawn history less their mean, in the unbounded space; no rows where the noise
        does not matter.
    """

    ratio: float
    noise_mm: float
    moves: FloatArray

    def spread(self, states: Sequence[EnsembleState], seed: int) -> list[EnsembleState]:
        """Add a draw of the displacement's share to each step of each walker; same seed, same numbers."""
        n = self.moves.shape[0]
        if n == 0:
            return list(states)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(97,)))
        root = self.moves / np.sqrt(n - 1)
        return [
            replace(state, chain=state.chain + rng.standard_normal((*state.chain.shape[:2], n)) @ root)
            for state in states
        ]

    @property
    def words(self) -> tuple[str, ...]:
        """One sentence for the reader, or none."""
        if not self.moves.size:
            return ()
        return (
            f"the noise of the displacement ({self.noise_mm:.2g} mm, {self.ratio:.1f} times the force noise when "
            "multiplied by K) is part of the intervals",
        )


def of_displacement(problem: Problem, start: Start, seed: int) -> Uncertainty:
    """Fit again with other displacements that the recording allows.

    The likelihood takes the smoothed displacement for the true one. Each copy takes the smoothed displacement for the
    truth, adds noise as large as the recording's and goes the same way: smoothing, reversals, most probable parameters.
    Their scatter is the variance between imputations (Rubin 1987, Multiple Imputation for Nonresponse in Surveys,
    section 3.3), which is added to the posterior's own. Their mean is left out: subtracting it as a bias (simulation
    and extrapolation) made the errors of 60 simulated devices larger, not smaller.

    Parameters
    ----------
    problem : Problem
        Posterior with the displacement as smoothed.
    start : Start
        Its top.
    seed : int
        Same seed, same copies.

    Returns
    -------
    Uncertainty
    """
    top = dict(zip(problem.layout.names, problem.natural(start.free[None])[0].tolist(), strict=True))
    noise = max(run.motion.noise_mm for run in problem.runs)
    ratio = max(value for name, value in top.items() if name.partition("_")[0] == "K") * noise / top["sigma"]
    if ratio < MATTERS:
        return Uncertainty(ratio, noise, np.empty((0, start.free.size)))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(96,)))
    tops = np.stack([polish(_copy(problem, rng), [start.free]).free for _ in range(N_COPIES)])
    return Uncertainty(ratio, noise, tops - tops.mean(axis=0))


def _copy(problem: Problem, rng: np.random.Generator) -> Problem:
    """Problem with another displacement that the recording allows, on fewer samples where it has many."""
    runs = []
    for run in problem.runs:
        whole = run.recording
        keep = slice(None, None, -(-whole.n_samples // N_SAMPLES))
        x = run.motion.displacement_mm[keep]
        x = x + run.motion.noise_mm / np.sqrt(keep.step) * rng.standard_normal(x.size)
        assert whole.used is not None
        recording = Recording(whole.time_s[keep], x, whole.force_kN[keep], used=whole.used[keep], source=whole.source)
        runs.append(Run(recording, motion_of(recording)))
    return replace(problem, runs=tuple(runs))
