"""The likelihood of one device: its averaged recordings held against a model of it."""

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
from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import InferenceError, PriorError
from shj_bayes.inference.binning import Blocks, Run, histories_of, reduce_runs
from shj_bayes.model.device import DeviceModel, linear_in, slopes_of
from shj_bayes.model.filter import LANES, log_density, sd_over_speed, slowness
from shj_bayes.model.history import History
from shj_bayes.model.parameters import base_of


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
STEP = 1e-4  # of the standardised free parameter; small against any posterior, large against rounding


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The recordings of a device held against a model of it: what fits, diagnosis and planning ask for densities."""

    blocks: Blocks  # the recordings
    model: DeviceModel  # what is believed of the device
    at_rest: float = 0.0  # logarithm of the white noise at rest over that at speed; see `filter.sd_over_speed`

    @property
    def runs(self) -> tuple[Run, ...]:
        """Consecutive runs, with all samples."""
        return tuple(part.run for part in self.blocks)

    @cached_property
    def histories(self) -> tuple[History, ...]:
        """Histories of the runs at all samples."""
        return histories_of(self.runs)

    def at(self, model: DeviceModel) -> Likelihood:
        """Give the same recordings held against another model."""
        return replace(self, model=model)

    def refined(self, z: FloatArray, *, longest_s: float | None = None, coarser: float = 1.0) -> Likelihood:
        """Average the recordings anew, with blocks that follow the bends of the force at one parameter set.

        It is unbounded, near the data, of the law at least; for the other arguments see `reduce_runs`.
        """
        still = self.model.laws.natural(z[None])
        if self.model.speed:  # the speed is noisy, and its share of the force is straight
            still[0, [base_of(name) == "gamma" for name in self.model.names]] = 0.0

        def force_at(history: History, start_force_kN: float) -> FloatArray:
            return np.asarray(self.model.force(still, history, start_force_kN)[0])

        blocks = reduce_runs(self.runs, force_at, longest_s=longest_s, coarser=coarser)
        return replace(self, blocks=blocks).with_noise_at_rest(self.at_rest)

    def with_noise_at_rest(self, at_rest: float) -> Likelihood:
        """Give the same with white noise whose standard deviation is exp(at_rest) times larger at rest."""
        rough = [part.mean(variance_over_speed(at_rest, part.history)) for part in self.blocks]
        parts = (
            replace(part, timing=replace(part.timing, rough=own)) for part, own in zip(self.blocks, rough, strict=True)
        )
        return replace(self, blocks=Blocks(parts), at_rest=at_rest)

    def residual_and_slope(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force of all blocks (kN; 0 without evidence) and the slope of the latter (kN/mm).

        For unbounded parameters, of the law at least, shape (m, n_law) to (m, n).
        """
        theta = self.model.laws.natural(z)
        pairs = [part.residual_and_slope(part.force(self.model, theta)) for part in self.blocks]
        return np.concatenate([a for a, _ in pairs], axis=1), np.concatenate([b for _, b in pairs], axis=1)

    def residual(self, z: FloatArray) -> FloatArray:
        """Measured less modelled force of all blocks, kN, for unbounded parameters, shape (m, n_law) to (m, n)."""
        return self.residual_and_slope(z)[0]

    def jacobian(self, z: FloatArray, residual: FloatArray) -> FloatArray:
        """Give the derivatives of the force after the unbounded parameters of the law, shape (n, n_law)."""
        out, linear = np.empty((residual.size, z.size)), linear_in(self.model)
        if linear.size:
            theta = self.model.laws.natural(z[None])[0]
            slopes = [slopes_of(self.model, theta, part.history, part.run.start_force_kN) for part in self.blocks]
            out[:, linear] = self.blocks.mean(slopes)
        steps = np.delete(STEP * np.eye(z.size), linear, axis=0)
        out[:, np.delete(np.arange(z.size), linear)] = (residual - self.residual(z + steps)).T / STEP
        return out

    def log_likelihood_by_half_cycle(self, theta: FloatArray) -> FloatArray:
        """Log likelihood of each half-cycle given those before it, shape (m, d) to (m, n_half of all runs)."""
        ends = np.cumsum([part.timing.half.size - 1 for part in self.blocks])
        out = np.empty((theta.shape[0], ends[-1]))
        for first in range(0, theta.shape[0], LANES):  # few sets at a time stay in the processor's cache
            sets = theta[first : first + LANES]
            noise = self.model.noise_values(sets)
            for part, end in zip(self.blocks, ends, strict=True):
                residual, slope = part.residual_and_slope(part.force(self.model, sets))
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
        theta = self.model.laws.natural(z[inside])
        with np.errstate(over="ignore", invalid="ignore"):
            value = self.log_likelihood(theta) + self.model.laws.log_density(z[inside])
        if np.isnan(value).any():
            if self.model.effects:  # far out in the prior an effect may leave no force at all
                value = np.where(np.isnan(value), -np.inf, value)
            else:
                bad = theta[np.flatnonzero(np.isnan(value))[0]]
                pairs = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.model.names, bad, strict=True))
                raise InferenceError(f"the likelihood is not a number at {pairs}; this is a bug, please report it")
        out[inside] = value
        return out

    @property
    def fingerprint(self) -> dict[str, str]:
        """What identifies recordings and model: name of each field to a digest or a word."""
        digest = hashlib.sha256()
        for run in self.runs:
            r, m = run.recording, run.motion
            channels = (r.time_s, r.force_kN, r.used, m.displacement_mm, m.speed_mm_s, m.start, m.turning_mm)
            further = (extra.values for extra in r.extras)
            for array in (*channels, m.direction, m.unsure, m.noise_mm, *further):
                digest.update(np.ascontiguousarray(array).tobytes())
        laws = [[p.name, p.law, p.a, p.b] for p in self.model.laws]
        return {
            "recordings": digest.hexdigest(),
            "version": shj_bayes.__version__,
            "parameters": ",".join(self.model.names),
            "noise": self.model.noise.id,
            "model": self.model.variant,
            "priors": hashlib.sha256(json.dumps(laws).encode()).hexdigest(),
        }


def make_likelihood(runs: Sequence[Run], model: DeviceModel) -> Likelihood:
    """Hold a model against the runs of a device, in blocks for a first look; `start.find_start` refines them.

    Each run begins with the force that is read. `PriorError` where the priors cannot hold the data.
    """
    if len(runs) != model.n_runs:
        raise InferenceError(f"{len(runs)} runs given, the model has {model.n_runs}")
    peak = float(np.percentile(np.abs(runs[0].recording.force_kN), 99))
    low, high = model.priors.of("Fy").quantile(np.array([1e-4, 1 - 1e-4]))
    if not low <= peak <= 2 * high:
        raise PriorError(
            f"{runs[0].recording.source.name}: the force reaches {peak:.3g} kN, but priors "
            f"'{model.priors.family}' are for sliding forces from {low:.3g} to {high:.3g} kN; check the unit "
            "(--units), or choose other priors (--priors general ships with shj-bayes)"
        )
    read = [replace(run, begins_kN=None) if run.begins_kN is not None else run for run in runs]
    return Likelihood(reduce_runs(read), model)


def variance_over_speed(at_rest: float, history: History) -> FloatArray:
    """Give the variance of the white noise over that at speed, at the points of a history, shape (n_points,)."""
    return sd_over_speed(at_rest, slowness(history.speed_mm_s, history.peak_speed_mm_s)) ** 2
