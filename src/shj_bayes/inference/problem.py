"""What is asked of the data: recordings, law, noise and priors bound into one posterior density."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

import shj_bayes
from shj_bayes.errors import InferenceError, PriorError
from shj_bayes.inference.moments import BY_SUMS, Moments, log_density_of_sums, moments_of
from shj_bayes.model.law import VARIANTS, check_laws, force_of_laws
from shj_bayes.model.noise import Stretches, log_density
from shj_bayes.model.parameters import FloatArray, Layout
from shj_bayes.model.priors import Priors
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.recording import Recording

FREE_LIMIT = 30.0  # in prior standard deviations; no prior has mass beyond


@dataclass(frozen=True, eq=False)
class Run:
    """One run as evidence.

    Parameters
    ----------
    recording : Recording
        The measured channels.
    motion : Motion
        Half-cycles, turning points and speed of its displacement.
    """

    recording: Recording
    motion: Motion

    def __post_init__(self) -> None:
        """Refuse a motion that belongs to another recording."""
        if self.motion.displacement_mm.size != self.recording.n_samples:
            raise InferenceError(
                f"{self.recording.source.name}: motion has {self.motion.displacement_mm.size} samples, "
                f"the recording {self.recording.n_samples}"
            )

    @cached_property
    def stretches(self) -> Stretches:
        """Samples that are evidence and lie on a known side of a reversal; the noise restarts after gaps in time."""
        used, unsure = self.recording.used, self.motion.unsure
        assert used is not None
        assert unsure is not None
        return Stretches(used & ~unsure, np.flatnonzero(self.recording.restarts))

    @cached_property
    def moments(self) -> Moments:
        """Sums over its samples from which the likelihood follows without going through them."""
        return moments_of(self.motion, self.recording.force_kN, self.stretches)

    @cached_property
    def start_force_kN(self) -> float:
        """Force with which the law starts: 0 for an unloaded device, else the median measured before it moves.

        A device counts as unloaded when that median is below 10 % of the largest force or within the noise: taking a
        noisy reading as the state would shift every loop that does not slide fully.
        """
        force, x = self.recording.force_kN, self.motion.displacement_mm
        moved = np.abs(x - x[0]) > 2e-3 * np.ptp(x)
        n_rest = max(1, int(np.argmax(moved)))
        first = float(np.median(force[:n_rest]))
        noise = 1.4826 * float(np.median(np.abs(np.diff(force))))
        return first if abs(first) > max(0.1 * float(np.abs(force).max()), 6 * noise) else 0.0


@dataclass(frozen=True, eq=False)
class Problem:
    """Posterior of one device.

    Parameters
    ----------
    runs : tuple of Run
        Consecutive runs.
    layout : Layout
        Parameters and noise model.
    priors : Priors
        Prior laws.
    variant : {"seed", "continuous"}
        Reversal rule of the law.
    """

    runs: tuple[Run, ...]
    layout: Layout
    priors: Priors
    variant: str = "seed"
    _memory: dict[tuple[int, int], FloatArray] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check that the parts fit together and that the priors can hold the data."""
        if len(self.runs) != self.layout.n_runs:
            raise InferenceError(f"{len(self.runs)} runs given, the layout has {self.layout.n_runs}")
        if self.variant not in VARIANTS:
            raise InferenceError(f"model '{self.variant}' is not known; choose one of {', '.join(VARIANTS)}")
        law = self.priors.of("Fy").distribution
        peak = float(np.percentile(np.abs(self.runs[0].recording.force_kN), 99))
        low, high = law.ppf([1e-4, 1 - 1e-4])
        if not low <= peak <= 2 * high:
            raise PriorError(
                f"{self.runs[0].recording.source.name}: the force reaches {peak:.3g} kN, but priors "
                f"'{self.priors.family}' are for sliding forces from {low:.3g} to {high:.3g} kN; check the unit "
                "(--units), or choose other priors (--priors general ships with shj-bayes)"
            )

    def natural(self, z: FloatArray) -> FloatArray:
        """Unbounded vectors, shape (m, d), to parameters in natural units, shape (m, d)."""
        columns = [self.priors.of(name).from_free(z[:, i]) for i, name in enumerate(self.layout.names)]
        return np.stack(columns, axis=1)

    def free(self, theta: FloatArray) -> FloatArray:
        """Parameters in natural units, shape (m, d), to unbounded vectors."""
        columns = [self.priors.of(name).to_free(theta[:, i]) for i, name in enumerate(self.layout.names)]
        return np.stack(columns, axis=1)

    def modelled_force(self, theta: FloatArray, run: int, out: FloatArray | None = None) -> FloatArray:
        """Force of run ``run`` (1 for the first) without noise, shape (m, n_samples of the run), kN."""
        part = self.runs[run - 1]
        return force_of_laws(
            part.motion,
            self.layout.laws(theta, run),
            variant=self.variant,
            start_force_kN=part.start_force_kN,
            out=out,
        )

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Log likelihood of parameters in natural units, shape (m, d) to (m,).

        Independent and AR(1) noise go by sums over blocks of samples (`moments`), at a cost that hardly grows with the
        sampling rate; Student noise, and parameter sets at which those sums overflow or cancel, by the samples.
        """
        if self.layout.noise not in BY_SUMS:
            return self.log_likelihood_by_samples(theta)
        noise = self.layout.noise_parameters(theta)
        total, sound = np.zeros(theta.shape[0]), np.ones(theta.shape[0], dtype=np.bool_)
        for number, run in enumerate(self.runs, start=1):
            laws = self.layout.laws(theta, number)
            check_laws(laws)
            sums, fine = run.moments.residual_sums(laws, variant=self.variant, start_force_kN=run.start_force_kN)
            total += log_density_of_sums(self.layout.noise, sums, run.stretches, **noise)
            sound &= fine
        if not sound.all():
            total[~sound] = self.log_likelihood_by_samples(theta[~sound])
        return total

    def log_likelihood_by_samples(self, theta: FloatArray) -> FloatArray:
        """Evaluate the log likelihood sample by sample; the same numbers as `log_likelihood`, and its oracle."""
        noise = self.layout.noise_parameters(theta)
        total = np.zeros(theta.shape[0])
        for number, run in enumerate(self.runs, start=1):
            residual = self.modelled_force(theta, number, out=self._workspace(theta.shape[0], number))
            np.subtract(run.recording.force_kN, residual, out=residual)
            total += log_density(self.layout.noise, residual, run.stretches, **noise)
        return total

    def log_prior_free(self, z: FloatArray) -> FloatArray:
        """Log prior density in the unbounded space, shape (m, d) to (m,)."""
        terms = [self.priors.of(name).log_density_free(z[:, i]) for i, name in enumerate(self.layout.names)]
        return np.asarray(np.sum(terms, axis=0))

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior density (up to a constant) in the unbounded space, shape (m, d) to (m,).

        Points outside the space that doubles can hold, and points where the law overflows, are ``-inf``;
        NaN is a bug and raises with the parameter set.
        """
        out = np.full(z.shape[0], -np.inf)
        inside = np.all(np.abs(z) < FREE_LIMIT, axis=1)
        if not inside.any():
            return out
        theta = self.natural(z[inside])
        with np.errstate(over="ignore", invalid="ignore"):
            value = self.log_likelihood(theta) + self.log_prior_free(z[inside])
        if np.isnan(value).any():
            bad = theta[np.flatnonzero(np.isnan(value))[0]]
            pairs = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.layout.names, bad, strict=True))
            raise InferenceError(f"the likelihood is not a number at {pairs}; this is a bug, please report it")
        out[inside] = value
        return out

    @property
    def fingerprint(self) -> dict[str, str]:
        """What identifies this posterior: name of each field to a digest or a word."""
        digest = hashlib.sha256()
        for run in self.runs:
            r, m = run.recording, run.motion
            channels = (r.time_s, r.force_kN, r.used, m.displacement_mm, m.speed_mm_s, m.start, m.turning_mm)
            for array in (*channels, m.direction, m.unsure):
                digest.update(np.ascontiguousarray(array).tobytes())
        priors = json.dumps({n: [p.law, p.a, p.b] for n, p in sorted(self.priors.priors.items())})
        return {
            "recordings": digest.hexdigest(),
            "version": shj_bayes.__version__,
            "parameters": ",".join(self.layout.names),
            "noise": self.layout.noise,
            "model": self.variant,
            "priors": hashlib.sha256(priors.encode()).hexdigest(),
        }

    def _workspace(self, m: int, run: int) -> FloatArray:
        """Memory for `m` force series of a run, reused from call to call; each thread has its own."""
        key = (threading.get_ident(), run)
        if key not in self._memory or self._memory[key].shape[0] < m:
            self._memory[key] = np.empty((m, self.runs[run - 1].recording.n_samples))
        return self._memory[key][:m]
