"""The posterior of one device: its model held against its averaged recordings."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

import shj_bayes
from shj_bayes.errors import InferenceError, PriorError
from shj_bayes.inference.binning import BinnedRun, Run, histories_of, reduce_runs
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.filter import LANES, log_density, sd_over_speed, slowness
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray, base_of


class Density(Protocol):
    """What a search or a sampler needs: a log density of many points at once."""

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (m, d), shape (m,)."""
        ...


@dataclass(frozen=True, eq=False)
class SharedDensity:
    """A density whose points are evaluated by several threads; each point's value is the same to the bit."""

    density: Density  # log density in the unbounded space; it must let go of the interpreter lock to be any faster here
    pool: ThreadPoolExecutor  # the threads
    n: int  # into how many parts a call is divided

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (m, d), shape (m,)."""
        if self.n < 2 or z.shape[0] < 2:
            return self.density.log_posterior_free(z)
        return np.concatenate(list(self.pool.map(self.density.log_posterior_free, np.array_split(z, self.n))))


def n_threads(asked: int) -> int:
    """Threads that are asked for, 0 for one per processor."""
    return asked or os.cpu_count() or 1


FREE_LIMIT = 30.0  # in prior standard deviations; no prior has mass beyond


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior density of one device."""

    runs: tuple[Run, ...]  # consecutive runs
    model: DeviceModel  # what is believed of the device
    averages: tuple[BinnedRun, ...]  # the runs in blocks
    at_rest: float = 0.0  # logarithm of the white noise at rest over that at speed; see `filter.sd_over_speed`

    def __post_init__(self) -> None:
        """Check that the parts fit together and that the priors can hold the data."""
        if len(self.runs) != self.model.n_runs:
            raise InferenceError(f"{len(self.runs)} runs given, the model has {self.model.n_runs}")
        peak = float(np.percentile(np.abs(self.runs[0].recording.force_kN), 99))
        low, high = self.model.priors.of("Fy").quantile(np.array([1e-4, 1 - 1e-4]))
        if not low <= peak <= 2 * high:
            raise PriorError(
                f"{self.runs[0].recording.source.name}: the force reaches {peak:.3g} kN, but priors "
                f"'{self.model.priors.family}' are for sliding forces from {low:.3g} to {high:.3g} kN; check the unit "
                "(--units), or choose other priors (--priors general ships with shj-bayes)"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters."""
        return self.model.names

    @cached_property
    def histories(self) -> tuple[History, ...]:
        """Histories of the runs at all samples."""
        return histories_of(self.runs)

    @property
    def n_blocks(self) -> int:
        """Number of blocks of all runs."""
        return sum(part.n for part in self.averages)

    def natural(self, z: FloatArray) -> FloatArray:
        """Unbounded vectors, shape (..., d), to parameters in natural units, shape (..., d)."""
        return self.model.natural(z)

    def refined(self, theta: FloatArray, *, longest_s: float | None = None, coarser: float = 1.0) -> Posterior:
        """Average the recordings anew, with blocks that follow the bends of the force at one parameter set, shape (d,).

        It is in natural units, near the data; for the other arguments see `reduce_runs`.
        """
        still = theta[None].copy()
        if self.model.speed:  # the speed is noisy, and its share of the force is straight
            for i, name in enumerate(self.names):
                still[0, i] *= 0.0 if base_of(name) == "gamma" else 1.0

        def force_at(history: History, start_force_kN: float) -> FloatArray:
            return np.asarray(self.model.force(still, history, start_force_kN)[0])

        averages = reduce_runs(self.runs, force_at, longest_s=longest_s, coarser=coarser)
        return replace(self, averages=averages).with_noise_at_rest(self.at_rest)

    def with_noise_at_rest(self, at_rest: float) -> Posterior:
        """Give the same posterior with white noise whose standard deviation is exp(at_rest) times larger at rest."""
        to = replace(self, at_rest=at_rest)
        rough = [part.mean(to.rough(part.history)) for part in self.averages]
        pairs = zip(self.averages, rough, strict=True)
        return replace(to, averages=tuple(replace(p, timing=replace(p.timing, rough=r)) for p, r in pairs))

    def rough(self, history: History) -> FloatArray:
        """Give the variance of the white noise over that at speed, at the points of a history, shape (n_points,)."""
        return sd_over_speed(self.at_rest, slowness(history.speed_mm_s, history.peak_speed_mm_s)) ** 2

    def residual_and_slope(self, theta: FloatArray, run: int) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force of each block of a run, and the slope of the latter, shape (m, n_blocks)."""
        part = self.averages[run - 1]
        return part.residual_and_slope(self.model.force(theta, part.history, part.start_force_kN))

    def law_residuals(self, z: FloatArray) -> FloatArray:
        """Residual of all blocks beside a constant of each run, for parameters of the law, (m, n_law) to (m, n), kN."""
        theta, out = self.model.natural_of_law(z), []
        for run, part in enumerate(self.averages, start=1):
            own = self.residual_and_slope(theta, run)[0]
            share = part.count / max(float(part.count.sum()), 1.0)
            out.append(np.where(part.count > 0, own - (own @ share)[:, None], 0.0))
        return np.concatenate(out, axis=1)

    def log_likelihood_by_half_cycle(self, theta: FloatArray) -> FloatArray:
        """Log likelihood of each half-cycle given those before it, shape (m, d) to (m, n_half of all runs)."""
        ends = np.cumsum([part.timing.half.size - 1 for part in self.averages])
        out = np.empty((theta.shape[0], ends[-1]))
        for first in range(0, theta.shape[0], LANES):  # few sets at a time stay in the processor's cache
            sets = theta[first : first + LANES]
            noise = self.model.noise_values(sets)
            for run, (part, end) in enumerate(zip(self.averages, ends, strict=True), start=1):
                residual, slope = self.residual_and_slope(sets, run)
                value = log_density(self.model.noise, noise, residual, slope, part.timing)
                out[first : first + LANES, end - value.shape[1] : end] = value
        return out

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Log likelihood of parameters in natural units, shape (m, d) to (m,)."""
        return np.asarray(self.log_likelihood_by_half_cycle(theta).sum(axis=1))

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
            value = self.log_likelihood(theta) + self.model.log_prior(z[inside])
        if np.isnan(value).any():
            if self.model.effects:  # far out in the prior an effect may leave no force at all
                value = np.where(np.isnan(value), -np.inf, value)
            else:
                bad = theta[np.flatnonzero(np.isnan(value))[0]]
                pairs = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.names, bad, strict=True))
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
            further = (extra.values for extra in r.extras)
            for array in (*channels, m.direction, m.unsure, m.noise_mm, *further):
                digest.update(np.ascontiguousarray(array).tobytes())
        laws = [[p.name, p.law, p.a, p.b] for p in self.model.laws_of_parameters]
        return {
            "recordings": digest.hexdigest(),
            "version": shj_bayes.__version__,
            "parameters": ",".join(self.names),
            "noise": self.model.noise.id,
            "model": self.model.variant,
            "priors": hashlib.sha256(json.dumps(laws).encode()).hexdigest(),
        }


def make_posterior(runs: Sequence[Run], model: DeviceModel) -> Posterior:
    """Hold a model against the runs of a device, in blocks for a first look; `start.find_start` refines them.

    Each run begins with the force that is read.
    """
    runs = tuple(replace(run, begins_kN=None) if run.begins_kN is not None else run for run in runs)
    return Posterior(runs, model, reduce_runs(runs))
