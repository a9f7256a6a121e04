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
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from shj_bayes.inference.binning import Run
from shj_bayes.inference.gaussian import Gaussian
from shj_bayes.inference.posterior import Posterior, make_posterior
from shj_bayes.inference.start import STEP, law_starts, started
from shj_bayes.model.curve import Curve
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.filter import AT_REST_SD, LOG_2PI, Timing, sd_over_speed, slowness, whiten
from shj_bayes.model.history import Measured
from shj_bayes.model.law import force_of_laws, masing_force
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.recording import BoolArray

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
    """The recordings of a device in blocks."""

    posterior: Posterior  # its base model, held against blocks that follow the bends of the force
    z: FloatArray  # shape (n_law,): least squares of the base model, where the search begins
    peak_mm_s: float | None = None  # peak speed that low speeds are a share of; that of the first run unless given
    longest_s: float | None = None  # longest block, s, where something comes again soon; as in a fit unless given

    @property
    def device(self) -> DeviceModel:
        """The base model."""
        return self.posterior.model

    @cached_property
    def scale_kN(self) -> float:
        """Sliding force of the base model, kN: the unit of sizes."""
        return self.device.law_values(self.z)["Fy"]

    @cached_property
    def noise_most_kN(self) -> float:
        """Largest standard deviation that the noise of a load cell may have, kN: of the largest force measured."""
        return NOISE_MOST * float(np.percentile(np.abs(self.measured_kN[self.used > 0]), 99))

    @cached_property
    def base(self) -> Base:
        """Base parameters for coordinates that need some."""
        law = self.device.law_values(self.z)
        return Base(law["K"], law["Fy"], law["beta"], law.get("gamma", 0.0), law["Fy"])

    @property
    def measured(self) -> Mapping[str, Measured]:
        """Further channels that the force may follow, by coordinate; as of the first run."""
        return self.posterior.averages[0].history.measured

    @cached_property
    def used(self) -> FloatArray:
        """1 for blocks that are evidence, 0 for the others, shape (n,)."""
        return (self.count > 0).astype(np.float64)

    @cached_property
    def count(self) -> FloatArray:
        """Samples that each block is the mean of, shape (n,); 0 where it is no evidence."""
        return np.concatenate([part.count for part in self.posterior.averages]).astype(np.float64)

    @cached_property
    def finer(self) -> BinnedData:
        """Give the same recordings in blocks as fine as those of a fit of the base model."""
        return self.finer_at(self.device, self.z)

    def finer_at(self, model: DeviceModel, z: FloatArray, longest_s: float | None = None) -> BinnedData:
        """Give the same recordings in blocks as fine as those of a fit of a model, which has bends of its own.

        With blocks of at most `longest_s`; 0 for all samples.
        """
        theta = model.natural_of_law(z[None])[0]
        longest_s = self.longest_s if longest_s is None else longest_s
        averages = replace(self.posterior, model=model).refined(theta, longest_s=longest_s).averages
        return replace(self, posterior=replace(self.posterior, averages=averages))

    def force(self, model: DeviceModel, z: FloatArray) -> FloatArray:
        """Modelled force of all blocks, shape (m, n_law) to (m, n), kN; 0 where there is no evidence."""
        return np.asarray((self.measured_kN - self.residual_and_slope(model, z)[0]) * self.used)

    @cached_property
    def measured_kN(self) -> FloatArray:
        """Measured force of all blocks, kN."""
        return np.concatenate([part.force_kN for part in self.posterior.averages])

    def residual_and_slope(self, model: DeviceModel, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force of all blocks (kN) and its slope (kN/mm), shape (m, n_law) to (m, n)."""
        theta = model.natural_of_law(z)
        pairs = [
            part.residual_and_slope(model.force(theta, part.history, part.start_force_kN))
            for part in self.posterior.averages
        ]
        return np.concatenate([a for a, _ in pairs], axis=1), np.concatenate([b for _, b in pairs], axis=1)

    def residual(self, model: DeviceModel, z: FloatArray) -> FloatArray:
        """Measured less modelled force of all blocks, shape (m, n_law) to (m, n), kN."""
        return self.residual_and_slope(model, z)[0]

    def jacobian(self, model: DeviceModel, z: FloatArray, residual: FloatArray) -> FloatArray:
        """Give the derivatives of the force after the unbounded parameters of the law, shape (n, n_law)."""
        out, linear = np.empty((residual.size, z.size)), model.linear
        if linear.size:
            theta, parts = model.natural_of_law(z[None])[0], self.posterior.averages
            out[:, linear] = self.blocks([model.slopes(theta, p.history, p.start_force_kN) for p in parts])
        steps = np.delete(STEP * np.eye(z.size), linear, axis=0)
        out[:, np.delete(np.arange(z.size), linear)] = (residual - self.residual(model, z + steps)).T / STEP
        return out

    def blocks(self, columns: Sequence[FloatArray]) -> FloatArray:
        """Means over blocks of functions at the points of each run, shapes (n_points, p) to (n, p)."""
        out = []
        for part, column in zip(self.posterior.averages, columns, strict=True):
            residual, _ = part.residual_and_slope(np.ascontiguousarray(column.T))
            out.append(np.where(part.count > 0, part.force_kN - residual, 0.0).T)
        return np.concatenate(out)

    def channel(self, name: str) -> FloatArray:
        """Channel of the histories at the blocks, shape (n,)."""
        return self.blocks([np.asarray(getattr(p.history, name))[:, None] for p in self.posterior.averages])[:, 0]

    @cached_property
    def waves(self) -> dict[tuple[str, str], FloatArray]:
        """Columns of `mismatch.waves` by action and coordinate: they are looked at beside many models."""
        return {}

    @cached_property
    def slow(self) -> FloatArray:
        """How far each block is one of low speed, 1 at rest to 0 at the peak, shape (n,)."""
        peak = self.peak_mm_s or self.posterior.averages[0].history.peak_speed_mm_s
        return slowness(self.channel("speed_mm_s"), peak)

    @cached_property
    def discrepancy(self) -> FloatArray:
        """Functions of the generic discrepancy, kN for a size of 1 kN, shape (n, p).

        They have no mean in either direction: a difference of push and pull is physics with a name.
        """
        histories = [part.history for part in self.posterior.averages]
        rows = self.blocks(
            [
                np.concatenate([c.rows(c.place(h, self.base), h.direction) for c in DISCREPANCY], axis=1)
                for h in histories
            ]
        )
        sense = self.channel("direction")
        for sign in (-1.0, 1.0):
            own = (np.sign(sense) == sign) & (self.used > 0)
            rows[own] -= rows[own].mean(axis=0)
        return rows

    @cached_property
    def memory(self) -> FloatArray:
        """Force under Masing's rule less that of the base law, kN, shape (n, 1).

        Both rules are in use for cycles that turn before the device slides; a device may follow either, or lie between.
        Under the published rule it also holds the jump of Eq. (1) behind each reversal, which Masing's rule has not.
        """
        theta = self.device.natural_of_law(self.z[None])
        columns = []
        for part in self.posterior.averages:
            motion, start = part.history.motion, part.start_force_kN
            laws = self.device.run_laws(theta, part.history.run)
            own = force_of_laws(motion, laws, variant=self.device.variant, start_force_kN=start)[0]
            columns.append((masing_force(motion, laws[0], start) - own)[:, None])
        return self.blocks(columns)

    def missed(self, slope: FloatArray) -> FloatArray:
        """Give what any model may miss: `discrepancy`, `memory`, `starts` and `zeros` side by side.

        `slope`, shape (n,), is that of the modelled force in each block, kN/mm.
        """
        return np.column_stack([self.discrepancy, self.memory, self.starts(slope), self.zeros])

    def starts(self, slope: FloatArray) -> FloatArray:
        """Error of where each run starts, kN for one of 1 mm, shape (n, n_runs).

        It moves the whole first half-cycle along the displacement, and stands for an error of the force there too.
        """
        first = [np.arange(part.n) < part.timing.half[1] for part in self.posterior.averages]
        return np.asarray(self.zeros * (slope * np.concatenate(first))[:, None])

    @cached_property
    def start_mm(self) -> FloatArray:
        """Standard deviation of where each run starts before the test, shape (n_runs,), mm."""
        return np.array([part.timing.turning_noise_mm[0] for part in self.posterior.averages])

    @cached_property
    def timings(self) -> tuple[Timing, ...]:
        """When the blocks of each run were taken, its start being known: `starts` holds its error."""
        whole = [part.timing for part in self.posterior.averages]
        return tuple(replace(t, turning_noise_mm=np.append(0.0, t.turning_noise_mm[1:])) for t in whole)

    @cached_property
    def zero_kN(self) -> FloatArray:
        """Standard deviation of the load cell's zero in each run before the test, shape (n_runs,), kN."""
        return np.array([part.timing.zero_noise_kN for part in self.posterior.averages])

    @property
    def step_s(self) -> float:
        """Time between two samples, s."""
        return self.posterior.averages[0].timing.step_s

    def parts_kN(self, noise: Mapping[str, float]) -> tuple[float, float]:
        """Give the standard deviations of noise, its white part on averages over `AVERAGED_S` and its slow part, kN."""
        parts = self.device.noise.parts({name: np.array([value]) for name, value in noise.items()})
        averaged = math.sqrt(min(1.0, self.step_s / AVERAGED_S))
        return float(parts.white_kN[0]) * averaged, float(parts.slow_kN[0])

    @cached_property
    def zeros(self) -> FloatArray:
        """Error of the load cell's zero in each run, kN for a size of 1 kN, shape (n, n_runs)."""
        sizes = [part.n for part in self.posterior.averages]
        return np.repeat(np.eye(len(sizes)), sizes, axis=0) * self.used[:, None]


@dataclass(frozen=True)
class ErrorParameters:
    """Noise and discrepancy of a device."""

    z: tuple[float, ...]  # parameters of the noise model in their unbounded space
    model_error_kN: float  # size of the discrepancy
    at_rest: float = 0.0  # logarithm of the standard deviation of the noise at low speed over that at high speed

    def values(self, data: BinnedData) -> dict[str, float]:
        """Parameters of the noise model in their units, by name."""
        laws = data.device.laws_of_parameters[data.device.n_law :]
        return {law.name: float(law.from_free(np.asarray(v))) for law, v in zip(laws, self.z, strict=True)}

    def size_kN(self, data: BinnedData) -> float:
        """Give the standard deviation of the noise where it is roughest, on averages over `AVERAGED_S`, kN."""
        return max(1.0, math.exp(self.at_rest)) * math.hypot(*data.parts_kN(self.values(data)))

    def log_prior(self, data: BinnedData) -> float:
        """Log prior density, but for a constant."""
        relative = self.model_error_kN / (MODEL_ERROR * data.scale_kN)
        return math.log(relative) - 0.5 * (
            float(np.dot(self.z, self.z)) + relative**2 + (self.at_rest / AT_REST_SD) ** 2
        )

    def sizes(self, data: BinnedData) -> FloatArray:
        """Size before the test of each column of `BinnedData.missed`, shape (p + 1 + 2 n_runs,)."""
        discrepancy = np.full(data.discrepancy.shape[1], self.model_error_kN)
        return np.concatenate([discrepancy, [1.0], data.start_mm, data.zero_kN])

    def whitened(self, data: BinnedData, columns: FloatArray, slope: FloatArray) -> tuple[FloatArray, float]:
        """Columns in units of what is new in the noise of each block, and the log density of data that are all 0.

        `slope`, shape (n,), is that of the modelled force in each block, through which the error of the displacement
        acts, kN/mm.
        """
        values, more = self.values(data), sd_over_speed(self.at_rest, data.slow)
        out, total, first = [], 0.0, 0
        for part, timing in zip(data.posterior.averages, data.timings, strict=True):
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
        laws = data.device.laws_of_parameters[data.device.n_law :]
        smaller = (
            float(law.to_free(law.from_free(np.asarray(z)) * most_kN / size)) if law.unit == "kN" else z
            for law, z in zip(laws, self.z, strict=True)
        )
        return replace(self, z=tuple(smaller))


class ErrorModel:
    """Scalar product in which noise and discrepancy count as they should; see the module.

    Parameters
    ----------
    data : BinnedData
        The recordings.
    setting : ErrorParameters
        Noise and discrepancy.
    slope : array, shape (n,)
        Slope of the modelled force in each block, through which the error of the displacement acts, kN/mm.
    counts : array, shape (n_evidence,), optional
        Which of the evidence a fit sees; all by default.

    Attributes
    ----------
    missed : array, shape (n, p + 1 + 2 n_runs)
        Functions of the discrepancy, Masing's rule, where each run starts, the zeros of the load cell; see
        `BinnedData.missed`.
    other : array, shape (n_evidence, p + 1 + 2 n_runs)
        The same whitened, each at its size before the test.
    """

    def __init__(
        self, data: BinnedData, setting: ErrorParameters, slope: FloatArray, counts: BoolArray | None = None
    ) -> None:
        self.data, self.setting, self.slope, self.counts = data, setting, slope, counts
        self.missed = data.missed(slope)
        white, constant = setting.whitened(data, self.missed, slope)
        self.other = self._counted(white) * setting.sizes(data)
        constant += setting.log_prior(data)
        self._missed = Gaussian(0.0, np.zeros(white.shape[1]), self.other.T @ self.other, constant)
        self.log_constant = self._missed.log_evidence
        self._known: dict[Hashable, tuple[FloatArray, FloatArray]] = {}

    def without(self, rows: BoolArray) -> ErrorModel:
        """Give the same metric for a fit that does not see some of the evidence, `rows` of shape (n_evidence,)."""
        return ErrorModel(self.data, self.setting, self.slope, ~rows)

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

    @property
    def is_slow(self) -> bool:
        """Whether most of the noise is remembered for longer than a half-cycle lasts."""
        history = self.data.posterior.averages[0].history
        lasts = np.array([history.time_s[-1] / history.motion.n_half])
        noise = self.setting.values(self.data)
        rows = {name: np.array([value]) for name, value in noise.items()}
        left = float(self.data.device.noise.decay(rows, lasts, self.data.step_s)[0, 0])
        white, slow = self.data.parts_kN(noise)
        return left * slow**2 > math.exp(-1.0) * (slow**2 + white**2)

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

    def discrepancy_of(self, residual: FloatArray) -> FloatArray:
        """Give what the discrepancy takes up of a residual, shape (n,), kN."""
        return self._parts_of(residual)[0]

    def integrated_out(self, residual: FloatArray) -> FloatArray:
        """Give what all that is integrated out but the discrepancy takes up of a residual, at its mean, (n,), kN."""
        return self._parts_of(residual)[1]

    def _parts_of(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give what the discrepancy takes up of a residual, and what the others do that are integrated out, kN."""
        mean = self._missed.solve(self.other.T @ self.whitened(residual[:, None])[:, 0])
        mean *= self.setting.sizes(self.data)
        n = self.data.discrepancy.shape[1]
        return self.data.discrepancy @ mean[:n], self.missed[:, n:] @ mean[n:]


def data_of(runs: Sequence[Run], device: DeviceModel) -> BinnedData:
    """Average consecutive runs of a device in blocks that follow the bends of its base model."""
    posterior = make_posterior(runs, device)
    posterior = started(posterior, device.natural_of_law(law_starts(posterior)[0][None])[0])
    z = law_starts(posterior)[0]
    theta = device.natural_of_law(z[None])[0]
    return BinnedData(posterior.refined(theta, coarser=COARSER), z)
