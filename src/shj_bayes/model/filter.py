"""Likelihood of averaged residuals: a scalar Kalman recursion, exact for even sampling and over gaps, in O(n).

A block is the mean of m samples d seconds apart; g seconds lie between the last sample of the block before and its
first. With the decay r over d and a over g of the slow part s (unit variance here), and s at the last sample of the
block before as state,

    mean = h s + e,   last = f s + w,   h = a A,   f = a r^(m-1),
    var e = V - h^2,  var w = 1 - f^2,  cov(e, w) = A - h f,

where A = (1 - r^m) / (m (1 - r)) and V = (m (1 - r^2) - 2 r (1 - r^m)) / (m^2 (1 - r)^2) are the covariance of a
block's mean with its last sample and the variance of its mean. The white part adds v sigma_white^2 / m, where v is the
mean over the block's samples of its variance over that at speed (`low_speed`).

The displacement is known to its noise only. To first order a block's force is then off by F'(x) times the mean error of
its displacement (variance of one sample over m), and all blocks behind one reversal by F'(x) times the error of its
turning point. The first is part of the block's variance; the second is one unknown number for each half-cycle, which is
integrated out in closed form. What the memory of the slow part carries of it beyond the half-cycle is left out.

The zero of the load cell is known to some share of its range only: one unknown constant in each run, integrated out in
closed form as well. Long rests at one end of the stroke would otherwise push it into the sliding force.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numba import njit

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray, freeze
from shj_bayes.errors import ModelError
from shj_bayes.model.noise import Noise, Values

LOG_2PI = math.log(2 * math.pi)
LANES = 8  # parameter sets side by side
N_ROWS = 17
# Where each row of the recursion's work begins: the slow part's estimate and variance, what a turning point's error
# would make of it, the white and slow variances, sums of squares, and the products of variances; what an error of the
# zero would make of the slow part, its products with what is new, with the turning point's error and with itself, and
# the first and the last of these over the half-cycles so far.
(
    STATE, VARIANCE, TURN, WHITE, SLOW, ACROSS, ALONG, OWN, PRODUCT, TOTAL, LAST,
    ZERO, WITH_NEW, WITH_TURN, WITH_SELF, ALL_WITH_NEW, ALL_WITH_SELF,
) = range(0, N_ROWS * LANES, LANES)  # fmt: skip
LARGE_NU = 1e300  # beyond it Student's t is the normal law
TOGETHER = 16  # variances that are multiplied before their logarithm is taken: within doubles from 1e-9 to 1e9 kN
SHORT = 1e-4  # of the memory: a block for which the series is the more exact
LOW_SPEED = 0.4  # of the peak speed, below which the noise may be another one
AT_REST_SD = 0.7  # sd before the test of the logarithm of its ratio: a factor of two either way


@dataclass(frozen=True, eq=False)
class Timing:
    """When the averages of one run were taken, and how well their displacement is known."""

    kind: IntArray  # shape (n,): row of `kinds` of each block; -1 for blocks that are no evidence
    # shape (n_kinds, 3): number of samples m, spacing d within the block (s), gap g before it (s; infinity where the
    # noise begins anew)
    kinds: FloatArray
    half: IntArray  # shape (n_half + 1,): half-cycle k holds the blocks ``half[k]:half[k+1]``
    step_s: float  # sampling interval of the recording, s
    displacement_noise_mm: float  # standard deviation of the error of one sample's displacement, mm
    # shape (n_half,): standard deviation of the error of each half-cycle's turning point, mm
    turning_noise_mm: FloatArray
    zero_noise_kN: float = 0.0  # standard deviation of the error of the load cell's zero in this run, kN
    # shape (n,): variance of the white part in each block over that at speed; one number for all of them to begin with
    rough: FloatArray = field(default_factory=lambda: np.ones(1))

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        freeze(self, "kind", "half", kind=np.int64)
        object.__setattr__(self, "rough", np.broadcast_to(self.rough, self.kind.shape))
        freeze(self, "kinds", "turning_noise_mm", "rough")
        if self.half[-1] != self.kind.size or self.turning_noise_mm.size != self.half.size - 1:
            raise ModelError("the blocks, half-cycles and turning points of a run do not belong together")

    @cached_property
    def share(self) -> FloatArray:
        """Shares of the variances of the white part and of the displacement that each block has, shape (n, 2)."""
        one = 1.0 / np.maximum(self.kinds[self.kind, 0], 1.0)
        return np.stack([one * self.rough, one], axis=1)


def log_density(noise: Noise, values: Values, residual: FloatArray, slope: FloatArray, timing: Timing) -> FloatArray:
    """Log density of averaged residuals by half-cycle, each given those before it, shape (m, n_half).

    For m sets of the noise's parameters, with measured less modelled force of each block (`residual`, kN) and the
    derivative of the modelled force after the displacement (`slope`, kN/mm), both of shape (m, n). The half-cycles add
    up to the log likelihood. Under heavy tails the zero of the load cell counts as known.
    """
    return _run(noise, values, residual, slope, timing)[:, :-2]


def density_and_zero(
    noise: Noise, values: Values, residual: FloatArray, slope: FloatArray, timing: Timing
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log density as from `log_density`, and what the residuals say of the error of the load cell's zero.

    The latter as mean and standard deviation, kN, each of shape (m,).
    """
    found = _run(noise, values, residual, slope, timing)
    along, own = found[:, -2:].T
    variance = timing.zero_noise_kN**2 / (1.0 + timing.zero_noise_kN**2 * own)
    return found[:, :-2], variance * along, np.sqrt(variance)


def _run(noise: Noise, values: Values, residual: FloatArray, slope: FloatArray, timing: Timing) -> FloatArray:
    """Run the recursion: log densities by half-cycle, then two columns on the zero, see `_filter`."""
    parts = noise.parts(values)
    out = np.empty((residual.shape[0], timing.half.size + 1))
    _filter(
        out,
        residual,
        slope,
        timing.kind,
        timing.share,
        table_of(noise, values, timing),
        timing.half,
        np.stack([parts.white_kN**2, parts.slow_kN**2, parts.nu, _student_constant(parts.nu)], axis=1),
        np.array([timing.displacement_noise_mm**2, timing.zero_noise_kN**2]),
        timing.turning_noise_mm**2,
    )
    return out


def whiten(
    noise: Noise,
    values: Mapping[str, float],
    columns: FloatArray,
    slope: FloatArray,
    timing: Timing,
    factor: FloatArray | None = None,
) -> tuple[FloatArray, float]:
    """Take from each column what the noise before predicts, in units of the standard deviation of what is new.

    The noise of whitened columns, shape (n, p), is independent and of unit variance. Errors of turning points count as
    independent from block to block, the zero of the load cell as known, heavy tails as normal ones. `factor`, shape
    (n,), is one on all noise of each block, by default 1. Gives the whitened columns of the blocks that are
    evidence, and the log determinant of the covariance; other arguments as for `log_density`, of one parameter set.
    """
    rows = {name: np.array([value]) for name, value in values.items()}
    parts = noise.parts(rows)
    table = table_of(noise, rows, timing)[0]
    own = timing.kind >= 0
    out = np.empty((int(np.count_nonzero(own)), columns.shape[1]))
    factor = np.ones(own.size) if factor is None else factor
    turning = np.repeat(timing.turning_noise_mm, np.diff(timing.half))
    steepness = timing.displacement_noise_mm**2 * timing.share[:, 1] + turning**2
    white = parts.white_kN[0] ** 2 * timing.share[:, 0] + steepness * (slope / factor) ** 2
    log_det = _whiten(out, columns, 1.0 / factor, timing.kind, table, white, float(parts.slow_kN[0] ** 2))
    return out, float(log_det + 2.0 * np.log(factor[own]).sum())


def simulate(
    noise: Noise, values: dict[str, float], time_s: FloatArray, restarts: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Draw one noise series, sample by sample, kN, for one set of parameters.

    The slow part begins anew at the samples in `restarts`.
    """
    rows = {name: np.array([value]) for name, value in values.items()}
    parts = noise.parts(rows)
    steps = np.diff(time_s, prepend=time_s[0])
    decay = np.where(restarts, 0.0, noise.decay(rows, steps, float(np.median(steps[1:])))[:, 0])
    decay[0] = 0.0
    nu, n = float(parts.nu[0]), time_s.size
    out = np.zeros(n)
    for scale, memory in ((parts.white_kN[0], np.zeros(n)), (parts.slow_kN[0], decay)):
        if scale > 0.0:
            draw = rng.standard_t(nu, n) if math.isfinite(nu) else rng.standard_normal(n)
            out += scale * _recurse(memory, draw)
    return out


def table_of(noise: Noise, values: Values, timing: Timing) -> FloatArray:
    """Coefficients of each kind of block, as `_coefficients`."""
    seconds = np.concatenate([timing.kinds[:, 1], timing.kinds[:, 2]])
    within, before = np.split(noise.decay(values, seconds, timing.step_s), 2)
    return np.asarray(_coefficients(timing.kinds[:, 0], within, before))


def _student_constant(nu: FloatArray) -> FloatArray:
    """Log of the normalising constant of a standard t density; 0 where it is normal."""
    return np.array(
        [
            math.lgamma((n + 1) / 2) - math.lgamma(n / 2) - 0.5 * math.log(n * math.pi) if math.isfinite(n) else 0.0
            for n in nu
        ]
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _coefficients(count, within, before):  # type: ignore[no-untyped-def]
    """h, f, V - h^2, 1 - f^2 and A - h f of each kind and parameter set, shape (n_sets, n_kinds, 5)."""
    n_kinds, n_sets = within.shape
    out = np.empty((n_sets, n_kinds, 5))
    for c in range(n_kinds):
        m = count[c]
        for j in range(n_sets):
            r = within[c, j]
            average, variance, last = 1.0, 1.0, 1.0
            if m > 1.0 and r == 0.0:
                average, variance, last = 1.0 / m, 1.0 / m, 0.0
            elif m > 1.0:
                x = -math.log(abs(r))
                if r > 0.0 and m * x < SHORT:  # a memory far longer than the block: the closed form loses its digits
                    average = 1.0 - x * (m - 1.0) / 2.0 + x * x * (m - 1.0) * (2.0 * m - 1.0) / 12.0
                    variance = 1.0 - x * (m * m - 1.0) / (3.0 * m) + x * x * (m * m - 1.0) / 12.0
                    last = math.exp(-(m - 1.0) * x)
                else:
                    power = math.exp(-m * x) * (-1.0 if r < 0.0 and m % 2.0 == 1.0 else 1.0)
                    less = 1.0 - r if r < 0.0 else -math.expm1(-x)
                    less_power = 1.0 - power if power < 0.5 else -math.expm1(-m * x)
                    average = less_power / (m * less)
                    variance = (m * less * (1.0 + r) - 2.0 * r * less_power) / (m * less) ** 2
                    last = power / r
            h, f = before[c, j] * average, before[c, j] * last
            out[j, c, 0], out[j, c, 1] = h, f
            out[j, c, 2], out[j, c, 3], out[j, c, 4] = max(variance - h * h, 0.0), 1.0 - f * f, average - h * f
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nnan", "nsz"})
def _filter(out, residual, slope, kind, share, table, half, scales, errors, noise_turn):  # type: ignore[no-untyped-def]
    """Fill `out` with the log density of each half-cycle; arrays as in `log_density`, variances in place of sds.

    `errors` has the variances of one sample's displacement and of the zero; the last two columns of `out` get the
    products of a zero that is off by 1 kN with the residual and with itself.

    `LANES` parameter sets go through the recursion side by side, as one vector instruction does them all: its chain of
    a division and a few products takes as long for one.
    """
    m, n = residual.shape
    lines = np.empty(2 * n * LANES)
    factors = np.empty(table.shape[1] * 5 * LANES)
    work = np.empty(N_ROWS * LANES)  # one array, so that the compiler sees that its rows do not overlap
    for first in range(0, m, LANES):
        _load(lines, factors, work, residual, slope, table, scales, first)
        heavy = scales[first, 2] < LARGE_NU
        for k in range(half.size - 1):
            for lane in range(LANES):
                work[TURN + lane] = work[ACROSS + lane] = work[ALONG + lane] = work[OWN + lane] = 0.0
                work[WITH_NEW + lane] = work[WITH_TURN + lane] = work[WITH_SELF + lane] = 0.0
                work[TOTAL + lane], work[PRODUCT + lane] = 0.0, 1.0
            count, turn = 0, noise_turn[k] if heavy else 0.0
            for i in range(half[k], half[k + 1]):
                c = kind[i]
                if c < 0:
                    continue
                _step(work, lines, factors, 2 * i * LANES, c * 5 * LANES, share[i, 0], errors[0] * share[i, 1] + turn)
                count += 1
                if heavy:
                    _add_tails(work, scales, first)
                if count % TOGETHER == 0:
                    for lane in range(LANES):
                        work[TOTAL + lane] -= 0.5 * math.log(work[PRODUCT + lane])
                        work[PRODUCT + lane] = 1.0
            for lane in range(min(LANES, m - first)):
                value = work[TOTAL + lane] - 0.5 * math.log(work[PRODUCT + lane])
                if not heavy:
                    spread = 1.0 + noise_turn[k] * work[OWN + lane]
                    # From the left: a product of 0 and the square, which may overflow, would be no number.
                    left = work[ACROSS + lane] - noise_turn[k] * work[ALONG + lane] * work[ALONG + lane] / spread
                    value -= 0.5 * (count * LOG_2PI + left + math.log(spread))
                    if errors[1] > 0.0 and value > -math.inf:
                        value += _about_zero(work, lane, noise_turn[k] / spread, errors[1])
                # Variances that vanish together: so little noise has no density, not an infinite one.
                out[first + lane, k] = value if value < math.inf else -math.inf
        for lane in range(min(LANES, m - first)):
            out[first + lane, -2], out[first + lane, -1] = work[ALL_WITH_NEW + lane], work[ALL_WITH_SELF + lane]


@njit(error_model="numpy", inline="always")
def _about_zero(work, lane, turn, variance):  # type: ignore[no-untyped-def]
    """Take up what a half-cycle says of the zero; give what integrating the zero out adds to its log density.

    From the left: the squares alone may overflow.
    """
    before = 1.0 + variance * work[ALL_WITH_SELF + lane]
    gain = work[ALL_WITH_NEW + lane] * (work[ALL_WITH_NEW + lane] / before)
    work[ALL_WITH_NEW + lane] += work[WITH_NEW + lane] - turn * work[ALONG + lane] * work[WITH_TURN + lane]
    work[ALL_WITH_SELF + lane] += work[WITH_SELF + lane] - turn * work[WITH_TURN + lane] * work[WITH_TURN + lane]
    after = 1.0 + variance * work[ALL_WITH_SELF + lane]
    return 0.5 * (
        variance * (work[ALL_WITH_NEW + lane] * (work[ALL_WITH_NEW + lane] / after) - gain) - math.log(after / before)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _load(lines, factors, work, residual, slope, table, scales, first):  # type: ignore[no-untyped-def]
    """Lay out what the recursion needs of `LANES` parameter sets side by side; the last lanes repeat the last set."""
    m, n = residual.shape
    for lane in range(LANES):
        j = min(first + lane, m - 1)
        work[WHITE + lane], work[SLOW + lane] = scales[j, 0], scales[j, 1]
        work[STATE + lane], work[VARIANCE + lane] = 0.0, scales[j, 1]
        work[ZERO + lane] = work[ALL_WITH_NEW + lane] = work[ALL_WITH_SELF + lane] = 0.0
        for c in range(table.shape[1]):
            for q in range(5):
                factors[(c * 5 + q) * LANES + lane] = table[j, c, q]
        for i in range(n):
            lines[2 * i * LANES + lane] = residual[j, i]
            lines[(2 * i + 1) * LANES + lane] = slope[j, i]


@njit(error_model="numpy", fastmath={"contract", "nnan", "nsz"}, inline="always")
def _step(work, lines, factors, at, of, share, steepness):  # type: ignore[no-untyped-def]
    """Go on by one block, in all lanes.

    `share` is the block's share of the white variance, `steepness` what the square of its slope adds to the variance.
    """
    for lane in range(LANES):
        h, f, steep = factors[of + lane], factors[of + LANES + lane], lines[at + LANES + lane]
        before, slow = work[VARIANCE + lane], work[SLOW + lane]
        square = steep * steep
        noise = work[WHITE + lane] * share + steepness * square
        variance = h * h * before + slow * factors[of + 2 * LANES + lane] + noise
        inverse = 1.0 / variance
        new = lines[at + lane] - h * work[STATE + lane]
        also = steep - h * work[TURN + lane]
        level = 1.0 - h * work[ZERO + lane]
        gain = (h * f * before + slow * factors[of + 4 * LANES + lane]) * inverse
        work[STATE + lane] = f * work[STATE + lane] + gain * new
        work[TURN + lane] = f * work[TURN + lane] + gain * also
        work[ZERO + lane] = f * work[ZERO + lane] + gain * level
        after = f * f * before + slow * factors[of + 3 * LANES + lane] - gain * gain * variance
        work[VARIANCE + lane] = max(after, 0.0)
        work[PRODUCT + lane] *= variance
        work[ACROSS + lane] += new * new * inverse
        work[ALONG + lane] += new * also * inverse
        work[OWN + lane] += also * also * inverse
        work[WITH_NEW + lane] += level * new * inverse
        work[WITH_TURN + lane] += level * also * inverse
        work[WITH_SELF + lane] += level * level * inverse
        work[LAST + lane] = new * new * inverse


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nnan", "nsz", "reassoc"})
def _whiten(out, columns, factor, kind, table, white, slow):  # type: ignore[no-untyped-def]
    """Fill `out` with the news of each column times a factor of its block; give the log determinant."""
    n, p = columns.shape
    state, variance = np.zeros(p), slow
    row, log_det = 0, 0.0
    for i in range(n):
        c = kind[i]
        if c < 0:
            continue
        h, f = table[c, 0], table[c, 1]
        total = h * h * variance + slow * table[c, 2] + white[i]
        gain = (h * f * variance + slow * table[c, 4]) / total
        scale = 1.0 / math.sqrt(total)
        for j in range(p):
            new = columns[i, j] * factor[i] - h * state[j]
            state[j] = f * state[j] + gain * new
            out[row, j] = new * scale
        variance = max(f * f * variance + slow * table[c, 3] - gain * gain * total, 0.0)
        log_det += math.log(total)
        row += 1
    return log_det


@njit(error_model="numpy", inline="always")
def _add_tails(work, scales, first):  # type: ignore[no-untyped-def]
    """Add the log density of the last block's news under Student's t, in all lanes."""
    for lane in range(LANES):
        j = min(first + lane, scales.shape[0] - 1)
        work[TOTAL + lane] += scales[j, 3]
        work[TOTAL + lane] -= 0.5 * (scales[j, 2] + 1.0) * math.log1p(work[LAST + lane] / scales[j, 2])


@njit(cache=True, error_model="numpy")
def _recurse(decay, draw):  # type: ignore[no-untyped-def]
    """Series of unit variance whose correlation with the sample before is `decay`."""
    out = np.empty(draw.size)
    before = 0.0
    for i in range(draw.size):
        before = decay[i] * before + math.sqrt(1.0 - decay[i] * decay[i]) * draw[i]
        out[i] = before
    return out


def slowness(speed_mm_s: FloatArray, peak_mm_s: float) -> FloatArray:
    """How far each speed is a low one, 1 at rest to 0 at the peak."""
    return np.asarray(np.exp(-((speed_mm_s / (LOW_SPEED * peak_mm_s)) ** 2)))


def sd_over_speed(at_rest: float, slow: FloatArray) -> FloatArray:
    """Give the standard deviation of the noise over that at speed, from its logarithm at rest and from `slowness`."""
    return np.asarray(1.0 + math.expm1(at_rest) * slow)
