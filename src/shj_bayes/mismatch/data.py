"""The recordings of a device as all models of a search see them: blocks, their noise, and what any model may miss.

Everything is held against one metric: white and slow noise, in each run the error of the load cell's zero and of where
the device stands at the start, Masing's rule in the place of the base law's in cycles that turn before the device
slides, and a generic discrepancy, smooth functions of position, slip and speed in each direction and of time whose size
is inferred (Kennedy and O'Hagan 2001, J. R. Statist. Soc. B 63, 425). All are linear, so they are integrated out in
closed form.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.inference.binning import Blocks, Run
from shj_bayes.inference.gaussian import Gaussian
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.start import law_starts, started
from shj_bayes.model.curve import Curve
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.filter import AT_REST_SD, LOG_2PI, Timing, sd_over_speed, slowness, whiten
from shj_bayes.model.law import force_of_laws, masing_force

COARSER = 2.5  # blocks than those of a fit: many models are compared
MODEL_ERROR = 0.003  # of Fy: scale of the half-normal prior of the discrepancy, the error of a good model of a device
NOISE_MOST = 0.03  # of the largest force: noise beyond it is no noise of a load cell
AVERAGED_S = 0.2  # over which noise is averaged before its size is judged: the same at any sampling rate
DISCREPANCY = tuple(Curve("added", name, 0.15, True, 1.0) for name in ("position", "slip", "speed"))
DISCREPANCY = (*DISCREPANCY, Curve("added", "time", 0.15, False, 1.0))
N_OF_DEVICE = sum(curve.n for curve in DISCREPANCY) + 1  # first columns of `ErrorModel.other`: the same in every run
N_OF_RUN = 2  # its columns that belong to a run: where it starts, and the zero


@dataclass(frozen=True, eq=False)
class BinnedData:
    """The recordings of a device in blocks, and its base law, beside which everything is told."""

    likelihood: Likelihood  # of the base model, with blocks that follow the bends of its force
    z: FloatArray  # shape (n_law,): least squares of the base model, where the search begins
    peak_mm_s: float | None = None  # peak speed that low speeds are a share of; that of the first run unless given
    longest_s: float | None = None  # longest block, s, where something comes again soon; as in a fit unless given
    # columns of `periodic.waves` by action and coordinate: they are looked at beside many models
    waves: dict[tuple[str, str], FloatArray] = field(init=False, default_factory=dict)

    @property
    def device(self) -> DeviceModel:
        """The base model."""
        return self.likelihood.model

    @property
    def blocks(self) -> Blocks:
        """The recordings."""
        return self.likelihood.blocks

    @cached_property
    def base(self) -> Base:
        """Base parameters for coordinates that need some."""
        law = self.device.law_values(self.z)
        return Base(law["K"], law["Fy"], law["beta"], law.get("gamma", 0.0), law["Fy"])

    @property
    def scale_kN(self) -> float:
        """Sliding force of the base model, kN: the unit of sizes."""
        return self.base.Fy

    @cached_property
    def noise_most_kN(self) -> float:
        """Largest standard deviation that the noise of a load cell may have, kN: of the largest force measured."""
        return NOISE_MOST * float(np.percentile(np.abs(self.blocks.force_kN[self.blocks.used > 0]), 99))

    def finer_at(self, model: DeviceModel, z: FloatArray, longest_s: float | None = None) -> BinnedData:
        """Give the same recordings in blocks as fine as those of a fit of a model, which has bends of its own.

        With blocks of at most `longest_s`; 0 for all samples.
        """
        longest_s = self.longest_s if longest_s is None else longest_s
        return replace(self, likelihood=self.likelihood.at(model).refined(z, longest_s=longest_s).at(self.device))

    @cached_property
    def slow(self) -> FloatArray:
        """How far each block is one of low speed, 1 at rest to 0 at the peak, shape (n,)."""
        peak = self.peak_mm_s or self.blocks[0].history.peak_speed_mm_s
        return slowness(self.blocks.channel("speed_mm_s"), peak)

    @cached_property
    def timings(self) -> tuple[Timing, ...]:
        """When the blocks of each run were taken, its start being known: `missed` holds its error."""
        whole = [part.timing for part in self.blocks]
        return tuple(replace(t, turning_noise_mm=np.append(0.0, t.turning_noise_mm[1:])) for t in whole)

    @cached_property
    def missed(self) -> FloatArray:
        """What any model may miss beside noise, kN, shape (n, p + 1 + 2 n_runs).

        The generic discrepancy for a size of 1 kN; the force under Masing's rule less that of the base law; what an
        error of 1 mm of where each run starts does to the base law; and the zero of each run.
        """
        return np.column_stack([_discrepancy(self), *_rules_and_starts(self), self.zeros])

    @property
    def zeros(self) -> FloatArray:
        """Error of the load cell's zero in each run, for a size of 1 kN, shape (n, n_runs)."""
        sizes = [part.n for part in self.blocks]
        return np.repeat(np.eye(len(sizes)), sizes, axis=0) * self.blocks.used[:, None]

    def missed_at(self, slope: FloatArray) -> FloatArray:
        """Give the columns of `missed` beside a model with such slopes of the force, kN/mm, shape (n,).

        An error of the start moves the whole first half-cycle along the displacement, and stands for an error of the
        force there too; where the device does not slide before it turns, what follows begins with another force.
        """
        first = np.concatenate([np.arange(part.n) < part.timing.half[1] for part in self.blocks])
        out, n = self.missed.copy(), len(self.blocks)
        out[first, -2 * n : -n] = (self.zeros * slope[:, None])[first]
        return out

    def missed_sizes(self, model_error_kN: float) -> FloatArray:
        """Size of each column of `missed` before the test, shape (p + 1 + 2 n_runs,)."""
        starts_mm = [part.timing.turning_noise_mm[0] for part in self.blocks]
        zeros_kN = [part.timing.zero_noise_kN for part in self.blocks]
        return np.array([*[model_error_kN] * (N_OF_DEVICE - 1), 1.0, *starts_mm, *zeros_kN])


def _discrepancy(data: BinnedData) -> FloatArray:
    """Functions of the generic discrepancy, kN for a size of 1 kN, shape (n, p).

    They have no mean in either direction: a difference of push and pull is physics with a name.
    """
    columns = []
    for history in (part.history for part in data.blocks):
        rows = [curve.rows(curve.place(history, data.base), history.direction) for curve in DISCREPANCY]
        columns.append(np.concatenate(rows, axis=1))
    means, sense = data.blocks.mean(columns), data.blocks.channel("direction")
    for sign in (-1.0, 1.0):
        own = (np.sign(sense) == sign) & (data.blocks.used > 0)
        means[own] -= means[own].mean(axis=0)
    return means


def _rules_and_starts(data: BinnedData) -> tuple[FloatArray, FloatArray]:
    """Force under Masing's rule less that of the base law, kN, and what an error of each start does to it, kN/mm.

    Both rules are in use for cycles that turn before the device slides; a device may follow either, or lie between.
    Under the published rule it also holds the jump of Eq. (1) behind each reversal, which Masing's rule has not.
    Shapes (n, 1) and (n, n_runs).
    """
    theta, step_kN = data.device.laws.natural(data.z[None]), 1e-3 * data.scale_kN
    rules, starts = [], []
    for i, part in enumerate(data.blocks):
        motion, start = part.history.motion, part.run.start_force_kN
        laws = data.device.run_laws(theta, part.history.run)
        less, own, more = (
            force_of_laws(motion, laws, variant=data.device.variant, start_force_kN=start + by)[0]
            for by in (-step_kN, 0.0, step_kN)
        )
        rules.append((masing_force(motion, laws[0], start) - own)[:, None])
        of_run = np.arange(len(data.blocks)) == i
        starts.append(of_run * (data.base.K * (more - less) / (2.0 * step_kN))[:, None])
    return data.blocks.mean(rules), data.blocks.mean(starts)


@dataclass(frozen=True)
class ErrorParameters:
    """Noise and discrepancy of a device."""

    z: tuple[float, ...]  # parameters of the noise model in their unbounded space
    model_error_kN: float  # size of the discrepancy
    at_rest: float = 0.0  # logarithm of the standard deviation of the noise at low speed over that at high speed

    def values(self, data: BinnedData) -> dict[str, float]:
        """Parameters of the noise model in their units, by name."""
        laws = data.device.laws[data.device.n_law :]
        return {law.name: float(law.from_free(np.asarray(v))) for law, v in zip(laws, self.z, strict=True)}

    def parts_kN(self, data: BinnedData) -> tuple[float, float]:
        """Give the standard deviations of noise, its white part on averages over `AVERAGED_S` and its slow part, kN."""
        parts = data.device.noise.parts({name: np.array([value]) for name, value in self.values(data).items()})
        averaged = math.sqrt(min(1.0, data.timings[0].step_s / AVERAGED_S))
        return float(parts.white_kN[0]) * averaged, float(parts.slow_kN[0])

    def size_kN(self, data: BinnedData) -> float:
        """Give the standard deviation of the noise where it is roughest, on averages over `AVERAGED_S`, kN."""
        return max(1.0, math.exp(self.at_rest)) * math.hypot(*self.parts_kN(data))

    def is_slow(self, data: BinnedData) -> bool:
        """Whether most of the noise is remembered for longer than a half-cycle lasts."""
        history = data.blocks[0].history
        lasts = np.array([history.time_s[-1] / history.motion.n_half])
        rows = {name: np.array([value]) for name, value in self.values(data).items()}
        left = float(data.device.noise.decay(rows, lasts, data.timings[0].step_s)[0, 0])
        white, slow = self.parts_kN(data)
        return left * slow**2 > math.exp(-1.0) * (slow**2 + white**2)

    def log_prior(self, data: BinnedData) -> float:
        """Log prior density, but for a constant."""
        relative = self.model_error_kN / (MODEL_ERROR * data.scale_kN)
        return math.log(relative) - 0.5 * (
            float(np.dot(self.z, self.z)) + relative**2 + (self.at_rest / AT_REST_SD) ** 2
        )

    def whitened(self, data: BinnedData, columns: FloatArray, slope: FloatArray) -> tuple[FloatArray, float]:
        """Columns in units of what is new in the noise of each block, and the log density of data that are all 0.

        `slope`, shape (n,), is that of the modelled force in each block, through which the error of the displacement
        acts, kN/mm.
        """
        values, more = self.values(data), sd_over_speed(self.at_rest, data.slow)
        out, total, first = [], 0.0, 0
        for part, timing in zip(data.blocks, data.timings, strict=True):
            own = slice(first, first + part.n)
            white, log_det = whiten(data.device.noise, values, columns[own], slope[own], timing, more[own])
            out.append(white)
            total, first = total + log_det, first + part.n
        white = np.concatenate(out)
        return white, -0.5 * (white.shape[0] * LOG_2PI + total)

    def at_most(self, data: BinnedData, most_kN: float) -> ErrorParameters:
        """Give the same noise, smaller where its size is more than this."""
        size = self.size_kN(data)
        if size <= most_kN:
            return self
        laws = data.device.laws[data.device.n_law :]
        smaller = (
            float(law.to_free(law.from_free(np.asarray(z)) * most_kN / size)) if law.unit == "kN" else z
            for law, z in zip(laws, self.z, strict=True)
        )
        return replace(self, z=tuple(smaller))


class ErrorModel:
    """Scalar product in which noise and discrepancy count as they should; see the module.

    `slope`, shape (n,), is that of the modelled force in each block, kN/mm; `counts`, shape (n_evidence,), says which
    of the evidence a fit sees. `missed` holds the columns of `BinnedData.missed`, each at its size before the test, and
    `other`, of shape (n_evidence, p + 1 + 2 n_runs), the same whitened.
    """

    def __init__(
        self, data: BinnedData, setting: ErrorParameters, slope: FloatArray, counts: BoolArray | None = None
    ) -> None:
        self.data, self.setting, self.slope, self.counts = data, setting, slope, counts
        missed, sizes = data.missed_at(slope), data.missed_sizes(setting.model_error_kN)
        white, constant = setting.whitened(data, missed, slope)
        self.missed, self.other = missed * sizes, self._counted(white) * sizes
        constant += setting.log_prior(data)
        self._missed = Gaussian(0.0, np.zeros(white.shape[1]), self.other.T @ self.other, constant)
        self.log_constant = self._missed.log_evidence
        self._known: dict[Hashable, tuple[FloatArray, FloatArray]] = {}

    def _counted(self, white: FloatArray) -> FloatArray:
        return white if self.counts is None else white * self.counts[:, None]

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Columns in units of what is new in the noise of each block, shapes (n, p) to (n_evidence, p)."""
        return self._counted(self.setting.whitened(self.data, columns, self.slope)[0])

    def products(self, columns: FloatArray) -> FloatArray:
        """Scalar products of columns, shape (n, p) to (p, p); kN of a column count by what they stand out."""
        white, taken = self.factors(columns)
        return np.asarray(white.T @ white - taken.T @ taken)

    def gaussian(self, columns: FloatArray) -> Gaussian:
        """Linear model of data, the first of the columns, by the others, shape (n, 1 + p)."""
        return Gaussian.of(self.products(columns), self.log_constant)

    @property
    def fluctuation(self) -> float:
        """Size of the noise as a share of Fy; see `ErrorParameters.size_kN`."""
        return self.setting.size_kN(self.data) / self.data.scale_kN

    @property
    def is_rough(self) -> bool:
        """Whether the force fluctuates by more than the noise of a load cell."""
        return self.setting.size_kN(self.data) > self.data.noise_most_kN

    @property
    def is_capped(self) -> bool:
        """Whether the noise would be larger than that of a load cell if it could: what is left is no smooth curve."""
        return self.setting.size_kN(self.data) > 0.999 * self.data.noise_most_kN

    def factors(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give whitened columns and what the discrepancy takes up of each: products are those of the former less these.

        Shapes (n_evidence, p) and (p + 1 + 2 n_runs, p), the rows of the latter being those of `other` made orthogonal.
        """
        white = self.whitened(columns)
        return white, self._missed.whitened(self.other.T @ white)

    def factors_of(self, columns: Mapping[Hashable, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Give the factors of columns side by side; those of a key are worked out once, as many models ask for them."""
        new = {key: own for key, own in columns.items() if key not in self._known}
        if new:
            ends = np.cumsum([own.shape[1] for own in new.values()])[:-1]
            parts = (np.split(whole, ends, axis=1) for whole in self.factors(np.column_stack(list(new.values()))))
            self._known |= dict(zip(new, zip(*parts, strict=True), strict=True))
        white, taken = zip(*(self._known[key] for key in columns), strict=True)
        return np.concatenate(white, axis=1), np.concatenate(taken, axis=1)

    def squares(self, columns: FloatArray) -> FloatArray:
        """Scalar product of each column with itself, shape (n, p) to (p,)."""
        white, taken = self.factors(columns)
        return np.asarray(np.sum(white**2, axis=0) - np.sum(taken**2, axis=0))

    def integrated_out(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give what the discrepancy takes up of a residual, and what all else does that is integrated out, (n,), kN."""
        mean = self._missed.solve(self.other.T @ self.whitened(residual[:, None])[:, 0])
        n = N_OF_DEVICE - 1
        return self.missed[:, :n] @ mean[:n], self.missed[:, n:] @ mean[n:]


def data_of(runs: Sequence[Run], device: DeviceModel) -> BinnedData:
    """Average consecutive runs of a device in blocks that follow the bends of its base model."""
    likelihood = make_likelihood(runs, device)
    likelihood = started(likelihood, law_starts(likelihood)[0])
    z = law_starts(likelihood)[0]
    return BinnedData(likelihood.refined(z, coarser=COARSER), z)
