"""The numbers behind the figures: bands, residuals, cycles, energy, loops of the prior. Nothing is drawn here."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.model.law import BETA_RANGE, force_of_laws, work_between
from shj_bayes.model.parameters import run_name
from shj_bayes.population.device import published_rows
from shj_bayes.population.quantities import LEVELS, band_of
from shj_bayes.recording.motion import Block, exact_motion, one_peak_speed
from shj_bayes.results.device import DeviceData, RunData
from shj_bayes.results.diagnosis import DiagnosisRecord, LeftOver
from shj_bayes.results.store import diagnosis_in, find

N_STROKE = 20
N_SHIFTS = 3  # enough for a band
N_BLOCKS = 400  # pieces of a recording over which the noise band is evened out
AT_REST = 0.1  # a run that starts or ends within this share of the stroke from the middle, starts or ends there
SLIDES = 0.7  # of the largest force: a middle of the stroke below it the device does not slide
LAW = ("K", "Fy", "beta", "gamma")
N_PRIOR, N_SHOWN, N_POSTERIOR = 1000, 80, 20
SAMPLES_PER_CYCLE = 240


class StrokeProfile(NamedTuple):
    """Mean residual over stroke of one run and direction, arrays of shape (n_bins,)."""

    centre_mm: FloatArray  # middle of the bin
    mean_kN: FloatArray
    # 5 and 95 % of what noise alone would give
    low_kN: FloatArray
    high_kN: FloatArray


def residual(run: RunData) -> FloatArray:
    """Measured force less the posterior mean of the law, kN, shape (n,)."""
    return np.asarray(run.force_kN - run.law_kN.mean(axis=0), dtype=np.float64)


def stroke_profiles(run: RunData) -> list[StrokeProfile]:
    """Mean residual over stroke for push and pull, beside what noise alone would give.

    Evidence counts, but within two samples of a reversal: there the published law jumps, and a reversal placed one
    sample off leaves a residual that is neither noise nor physics.
    """
    counted = run.used.copy()
    beside = (run.reversals[:, None] + np.arange(-2, 2)).ravel()
    counted[beside[(beside >= 0) & (beside < counted.size)]] = False
    edges = edges_of(run.displacement_mm, N_STROKE)
    index, left = index_in(run.displacement_mm, edges), residual(run)
    noise = np.ascontiguousarray(run.predicted_kN - run.law_kN)
    # The fitted noise is stationary, so each draw may be moved in time to give several.
    shifts = np.linspace(0, noise.shape[1], N_SHIFTS, endpoint=False).astype(int)
    out = []
    for sign in (1, -1):
        inside = counted & (run.direction == sign)
        mean = bin_means(index, left, inside, N_STROKE)
        there = np.isfinite(mean)
        at, count = np.flatnonzero(inside), np.bincount(index[inside], minlength=N_STROKE)
        sums = [np.bincount(index[at], row[at - step], N_STROKE)[there] for row in noise for step in shifts]
        low, high = np.quantile(sums / count[there], (0.05, 0.95), axis=0)
        out.append(StrokeProfile(0.5 * (edges[:-1] + edges[1:])[there], mean[there], low, high))
    return out


def edges_of(values: FloatArray, n_bins: int) -> FloatArray:
    """Edges of even bins over the range of values."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high if high > low else low + 1.0, n_bins + 1)


def index_in(values: FloatArray, edges: FloatArray) -> IntArray:
    """Bin of each value."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2).astype(np.int64)


def bin_means(index: IntArray, what: FloatArray, inside: BoolArray, size: int, fewest: int = 1) -> FloatArray:
    """Mean of the samples of each bin; nan where there are fewer than `fewest`."""
    count = np.bincount(index[inside], minlength=size)
    total = np.bincount(index[inside], weights=what[inside], minlength=size)
    return np.where(count >= fewest, total / np.maximum(count, 1), np.nan)


class Band(NamedTuple):
    """Predicted force of one run, each array of shape (n,), kN: median, and 5 and 95 % of what would be measured."""

    median: FloatArray
    force_low: FloatArray
    force_high: FloatArray
    law_width_kN: float  # typical width of the 90 % band of the law


def force_band(run: RunData) -> Band:
    """Median and 90 % bands of the predicted force.

    The band of the law is point by point; that of the measured force evened out over neighbouring samples, since a
    hundred noisy draws give a ragged edge that says nothing.
    """
    low, median, high = np.quantile(run.law_kN, LEVELS, axis=0)
    n = median.size
    edges = np.unique(np.linspace(0, n, min(N_BLOCKS, n) + 1).astype(int))
    off = run.predicted_kN - median
    pieces, sizes = np.empty((edges.size - 1, 2)), np.diff(edges)
    for size in np.unique(sizes):  # all pieces of a size at once
        at = edges[:-1][sizes == size, None] + np.arange(size)
        pieces[sizes == size] = np.quantile(off[:, at], (LEVELS[0], LEVELS[2]), axis=(0, 2)).T
    centres = 0.5 * (edges[:-1] + edges[1:] - 1)
    below, above = (np.interp(np.arange(n), centres, pieces[:, i]) for i in (0, 1))
    return Band(median, median + below, median + above, float(np.median(high - low)))


def cycle_marks(run: RunData) -> FloatArray:
    """Where cycles begin and end, as fractional sample numbers, shape (n_cycles + 1,); empty without a full cycle.

    A cycle goes from one crossing of mid-stroke to the next in the same direction, beginning with the direction in
    which the run starts; so a block of sine cycles gives exactly its cycles, as closed loops.
    """
    x = run.displacement_mm
    if run.reversals.size == 0:
        return np.empty(0)
    turning = x[run.reversals]
    toward, middle = int(run.direction[0]), 0.5 * (float(turning.max()) + float(turning.min()))
    y = toward * (x - middle)
    before = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0) & (run.direction[:-1] == toward))
    # Noise can cross mid-stroke several times in one sweep: only the first crossing of each half-cycle counts.
    before = before[np.unique(run.half_cycle[before], return_index=True)[1]]
    marks = before + y[before] / (y[before] - y[before + 1])
    # A run that starts or stops at mid-stroke has its first and last crossing on its very ends.
    first, last = run.half_cycle[0], run.half_cycle[-1]
    crossed = run.half_cycle[before]
    if first not in crossed and abs(y[0]) < AT_REST * abs(toward * (turning[0] - middle)):
        marks = np.concatenate([[0.0], marks])
    if last not in crossed and run.direction[-1] == toward and abs(y[-1]) < AT_REST * abs(turning[-1] - middle):
        marks = np.concatenate([marks, [x.size - 1.0]])
    return np.asarray(marks, dtype=np.float64) if marks.size > 1 else np.empty(0)


class Cycles(NamedTuple):
    """Energy, envelope, sliding force and damping of the full cycles of one run, arrays of shape (n_cycles,)."""

    run: int
    amplitude_mm: FloatArray
    peak_speed_mm_s: FloatArray
    # measured, and 5, 50 and 95 % of what the posterior predicts would be measured
    measured_J: FloatArray
    low_J: FloatArray
    median_J: FloatArray
    high_J: FloatArray
    # the envelope: largest and smallest measured force
    push_kN: FloatArray
    pull_kN: FloatArray
    # the backbone, shape (2 n_cycles,): displacement where the cycles turn, and measured and modelled force there
    turn_mm: FloatArray
    turn_kN: FloatArray
    model_turn_kN: FloatArray
    # median measured force over the middle half of the stroke, displacement growing and falling; NaN where the device
    # does not slide there
    push_sliding_kN: FloatArray
    pull_sliding_kN: FloatArray
    # equivalent viscous damping of the measured and of the modelled loop, W / (2 pi F x): W its energy, F half the
    # range of the force, x half that of the displacement (Chopra, Dynamics of Structures, section 3.9). A rectangle has
    # 63.7 %.
    damping_percent: FloatArray
    model_damping_percent: FloatArray

    @property
    def n_outside(self) -> int:
        """Cycles whose measured energy lies outside the predicted band."""
        return int(np.sum((self.measured_J < self.low_J) | (self.measured_J > self.high_J)))


def cycles_of(run: RunData, median_kN: FloatArray) -> Cycles:
    """Measure every full cycle of a run, and what is predicted of it; `median_kN` is the modelled force."""
    marks = cycle_marks(run)
    spans = whole_spans(marks)
    x, f, direction = run.displacement_mm, run.force_kN, run.direction
    turns = np.array([a + int(at) for a, b in spans for at in (np.argmax(x[a:b]), np.argmin(x[a:b]))], dtype=np.int64)
    amplitude, measured = np.array([0.5 * np.ptp(x[a:b]) for a, b in spans]), work_between(f, x, marks)
    low, middle, high = np.quantile(work_between(run.predicted_kN, x, marks), LEVELS, axis=0)

    def sliding(a: int, b: int, sign: int) -> float:
        middle, quarter = 0.5 * (x[a:b].max() + x[a:b].min()), 0.25 * np.ptp(x[a:b])
        rows = (np.abs(x[a:b] - middle) <= quarter) & (direction[a:b] == sign)
        flat = sign * float(np.median(f[a:b][rows])) if rows.any() else 0.0
        return sign * flat if flat > SLIDES * np.max(sign * f[a:b]) else np.nan

    def damping(energy_J: FloatArray, force: FloatArray) -> FloatArray:
        # Not the extremes: of noisy samples they are too large.
        half = np.array([0.5 * np.subtract(*np.quantile(force[a:b], (0.98, 0.02))) for a, b in spans])
        return np.asarray(100 * energy_J / (2 * np.pi * half * amplitude))

    return Cycles(
        run.number,
        amplitude,
        # The largest of many noisy speeds is too large; the 98th percentile of a sine is its peak to 0.1 %.
        np.array([np.quantile(run.speed_mm_s[a:b], 0.98) for a, b in spans]),
        measured,
        low,
        middle,
        high,
        np.array([f[a:b].max() for a, b in spans]),
        np.array([f[a:b].min() for a, b in spans]),
        x[turns],
        f[turns],
        median_kN[turns],
        np.array([sliding(a, b, 1) for a, b in spans]),
        np.array([sliding(a, b, -1) for a, b in spans]),
        damping(measured, f),
        damping(middle, median_kN),
    )


def whole_spans(marks: FloatArray) -> list[tuple[int, int]]:
    """Sample ranges of the cycles, first included, last excluded."""
    whole = np.round(marks).astype(int)
    return [(int(a), max(int(b) + 1, int(a) + 2)) for a, b in pairwise(whole)]


def pick_cycle(run: RunData) -> slice:
    """Choose the samples of a cycle to show.

    The last of those whose amplitude is near the largest; cycles that have another of the same amplitude go
    before those that have none (ramps, where loops do not close). All samples where there is no cycle.
    """
    spans = whole_spans(cycle_marks(run))
    if not spans:
        return slice(0, run.time_s.size)
    amplitude = np.array([np.ptp(run.displacement_mm[a:b]) for a, b in spans])
    alike = np.abs(amplitude[:, None] - amplitude) < 0.05 * amplitude
    repeated = alike.sum(axis=1) > 1
    near = amplitude.max() - amplitude + np.where(repeated | ~repeated.any(), 0.0, np.inf)
    return slice(*spans[int(np.flatnonzero(near <= near.min() + 0.03 * amplitude.max())[-1])])


class Beforehand(NamedTuple):
    """One steady sine cycle under prior, paper and posterior."""

    amplitude_mm: float
    peak_speed_mm_s: float
    displacement_mm: FloatArray  # shape (n,): a closed loop
    # forces, shape (m, n); those of the paper have no rows where the priors are not of the paper's kind of device
    prior_kN: FloatArray
    paper_kN: FloatArray
    posterior_kN: FloatArray
    # 5 and 95 % of the largest force
    prior_range_kN: FloatArray
    posterior_range_kN: FloatArray
    paper_inside: int  # published loops whose largest force lies within the central 98 % of the prior of their run


class DeviceFigures(NamedTuple):
    """All that is drawn or said, computed once; lists are run by run."""

    bands: list[Band]
    cycles: list[Cycles]
    losses: dict[int, tuple[float, float, float]]  # of sliding force from run 1 to this one, per cent: 5, 50 and 95 %
    profiles: list[list[StrokeProfile]]
    one_speed: float | None
    before: Beforehand


def numbers_of(device: DeviceData) -> DeviceFigures:
    """Compute the numbers of a device page."""
    bands = [force_band(run) for run in device.runs]
    cycles = [cycles_of(run, band.median) for run, band in zip(device.runs, bands, strict=True)]
    first, speeds = device.runs[0], [c.peak_speed_mm_s for c in cycles]
    whole = 0.5 * float(np.ptp(first.displacement_mm))
    amplitude = max((float(c.amplitude_mm.max()) for c in cycles if c.amplitude_mm.size), default=whole)
    speed = max((float(np.median(own)) for own in speeds if own.size), default=0.0)
    return DeviceFigures(
        bands,
        cycles,
        {
            run.number: band_of(100 * (1 - device.draws[run_name("ratio", run.number)].ravel()))
            for run in device.runs[1:]
        },
        [stroke_profiles(run) for run in device.runs],
        one_peak_speed(np.concatenate(speeds)),
        beforehand(device, amplitude, speed or float(np.quantile(first.speed_mm_s, 0.98))),
    )


def left_over(device: DeviceData, folder: Path | None = None) -> LeftOver:
    """Measure what the model leaves over; a diagnosis of the same recordings in `folder` is taken note of."""
    parts = [residual(run)[run.used] for run in device.runs]
    rms = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    # Median-based, so that the jumps at reversals do not count as scatter.
    short = 1.4826 * float(np.median(np.abs(np.concatenate([np.diff(part) for part in parts])))) / np.sqrt(2)
    capacity = max(abs(float(np.median(device.draws["Fy"]))), 1e-12)
    looked = find(DiagnosisRecord, folder / diagnosis_in(folder)) if folder else None
    same = looked is not None and looked.sha256_of_inputs == device.record.sha256_of_inputs
    return LeftOver(
        unexplained_percent=100.0 * float(np.sqrt(max(rms**2 - short**2, 0.0))) / capacity,
        n_cycles=sum(max(0, cycle_marks(run).size - 1) for run in device.runs),
        widening=max(device.record.cycles.widening.values(), default=1.0),
        diagnosed=looked.verdict if looked and same else "",
    )


def beforehand(device: DeviceData, amplitude_mm: float, peak_speed_mm_s: float) -> Beforehand:
    """Loops of one sine cycle of the amplitude and peak speed that were tested."""
    sine = amplitude_mm, peak_speed_mm_s, device.record.model.variant
    draws = {name: values.ravel() for name, values in device.draws.items()}
    prior, paper, after, inside = [], [], [], 0
    for run in (1, 2) if "ratio" in draws else (1,):
        # A second run has its own prior: that of the ratio widens that of the sliding force.
        x, force = steady_cycle(_laws(device.prior, N_PRIOR, run), *sine)
        prior.append(force)
        after.append(_laws(draws, N_POSTERIOR, run))
        if device.record.model.priors == "afc":
            paper.append(steady_cycle(_published_laws(run), *sine)[1])
            low, high = np.quantile(_largest(force), (0.01, 0.99))
            inside += int(np.sum((_largest(paper[-1]) >= low) & (_largest(paper[-1]) <= high)))
    before, (_, posterior) = np.concatenate(prior), steady_cycle(np.concatenate(after), *sine)
    return Beforehand(
        amplitude_mm,
        peak_speed_mm_s,
        x,
        before[:: max(1, before.shape[0] // N_SHOWN)],
        np.concatenate(paper) if paper else np.empty((0, x.size)),
        posterior,
        np.quantile(_largest(before), (0.05, 0.95)),
        np.quantile(_largest(posterior), (0.05, 0.95)),
        inside,
    )


def steady_cycle(
    laws: FloatArray, amplitude_mm: float, peak_speed_mm_s: float, variant: str
) -> tuple[FloatArray, FloatArray]:
    """Displacement, shape (n,), and force, shape (m, n), of a closed sine cycle; laws that overflow are left out."""
    frequency = peak_speed_mm_s / (2 * np.pi * amplitude_mm)
    _, motion = exact_motion((Block(amplitude_mm, frequency, 2),), SAMPLES_PER_CYCLE * frequency)
    laws = laws.copy()
    laws[:, 2] = np.clip(laws[:, 2], *BETA_RANGE)
    with np.errstate(over="ignore", invalid="ignore"):
        force = force_of_laws(motion, laws, variant=variant)
    loop = slice(int(motion.start[1]), int(motion.start[3]) + 1)
    force = force[np.all(np.isfinite(force), axis=1)]
    return motion.displacement_mm[loop], force[:, loop]


def _largest(force_kN: FloatArray) -> FloatArray:
    """Largest force of each loop."""
    return np.asarray(np.abs(force_kN).max(axis=1))


def _laws(draws: Mapping[str, FloatArray], n: int, run: int) -> FloatArray:
    """Law parameters of `n` evenly spread draws, shape (n, 4)."""
    at = np.linspace(0, draws["Fy"].size - 1, n).astype(int)
    still = np.zeros(draws["Fy"].size)  # gamma of a law without speed dependence
    laws = np.stack([draws.get(name, still)[at] for name in LAW], axis=1)
    if run == 2:
        laws[:, 1] *= draws["ratio"][at]
    return laws


def _published_laws(run: int) -> FloatArray:
    """Law parameters of one run of the published devices, shape (25, 4)."""
    laws = np.array([[row.values[name, run] for name in ("K", "Fy", "beta", "dep")] for row in published_rows()])
    laws[:, 3] = 1 / laws[:, 3]
    return laws
