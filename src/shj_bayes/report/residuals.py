"""Is what the model leaves over noise, or does it have a shape? Numbers only.

Noise is correlated from sample to sample, so thousands of samples are not thousands of facts. Two looks that respect
this, and a third at the noise model itself:

* against noise drawn from the fitted noise model: binned mean residuals over stroke, over distance since reversal and
  over time, measured with the spread that the fitted noise alone gives them;
* from cycle to cycle: what is noise changes sign at random from one cycle to the next, what is shape comes again.
  Needs no noise model, so a noise model that has swallowed the shape cannot hide it;
* a noise model whose memory is as long as a good part of a cycle describes shape, not noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.data import BoolArray, DeviceData, IntArray, RunData
from shj_bayes.report.numbers import cycle_marks

N_STROKE, N_START, N_TIME = 20, 10, 40
N_SHIFTS, N_FLIPS = 10, 1999
MIN_CYCLES = 8  # fewer cycles cannot reach a p value below 1 %
LEVEL = 0.01
LONG_MEMORY = 0.1  # of the shortest cycle


@dataclass(frozen=True, eq=False)
class StrokeProfile:
    """Mean residual over stroke of one run and direction, arrays of shape (n_bins,).

    Parameters
    ----------
    run, direction : int
        Number of the run; +1 push, -1 pull.
    centre_mm, mean_kN : array
        Middle of the bin and mean residual there.
    low_kN, high_kN : array
        5 and 95 % of what noise alone would give.
    """

    run: int
    direction: int
    centre_mm: FloatArray = field(repr=False)
    mean_kN: FloatArray = field(repr=False)
    low_kN: FloatArray = field(repr=False)
    high_kN: FloatArray = field(repr=False)


@dataclass(frozen=True)
class Size:
    """Size of the residual.

    Parameters
    ----------
    rms_kN, short_kN : float
        Root mean square, and scatter from one sample to the next.
    lag_one : float
        Lag-one correlation.
    """

    rms_kN: float
    short_kN: float
    lag_one: float


@dataclass(frozen=True)
class Place:
    """Where the mean residual over stroke stands out most.

    Parameters
    ----------
    mean_kN, share : float
        Mean residual there, and its size as a share of the sliding force.
    at_mm : float
        Displacement.
    run, direction : int
        Number of the run; +1 where displacement grows, -1 where it falls.
    where : str
        The place in words.
    """

    mean_kN: float
    share: float
    at_mm: float
    run: int
    direction: int
    where: str


@dataclass(frozen=True)
class Structure:
    """What the residual looks like.

    Parameters
    ----------
    p_noise : float
        Share of noise-only residuals at least as structured as the measured one.
    p_repeat : float or None
        The same by flipping the sign of whole cycles; None with fewer than eight cycles.
    memory_s, shortest_cycle_s : float
        Correlation time of the fitted noise (0 without correlation) and duration of the shortest cycle.
    independent_noise : bool
        True when the fit took the noise as independent.
    size : Size
        How large the residual is.
    largest : Place
        Where it stands out most.
    """

    p_noise: float
    p_repeat: float | None
    memory_s: float
    shortest_cycle_s: float
    independent_noise: bool
    size: Size
    largest: Place

    @property
    def absorbed(self) -> bool:
        """True when the noise model has a memory comparable with the cycles."""
        return self.memory_s > LONG_MEMORY * self.shortest_cycle_s

    @property
    def unmodelled_correlation(self) -> bool:
        """True when noise taken as independent is not."""
        return self.independent_noise and self.size.lag_one > 0.2

    @property
    def structured(self) -> bool:
        """True when more than noise is seen."""
        return self.seen or self.absorbed or self.unmodelled_correlation

    @property
    def seen(self) -> bool:
        """True when the residual itself shows a shape, whatever the noise model says."""
        return self.p_noise < LEVEL or (self.p_repeat is not None and self.p_repeat < LEVEL)


def residual(run: RunData) -> FloatArray:
    """Measured force less the posterior mean of the law, kN, shape (n,)."""
    return np.asarray(run.force_kN - run.law_kN.mean(axis=0), dtype=np.float64)


def counted(run: RunData) -> BoolArray:
    """Mark the samples that count: evidence, and not within two samples of a reversal.

    There the published law jumps, and a reversal placed one sample off leaves a residual that is neither noise nor
    physics.
    """
    keep = run.used.copy()
    for shift in (-2, -1, 0, 1):
        at = run.reversals + shift
        keep[at[(at >= 0) & (at < keep.size)]] = False
    return keep


def stroke_profiles(run: RunData, n_bins: int = N_STROKE) -> tuple[StrokeProfile, StrokeProfile]:
    """Mean residual over stroke for push and pull, beside what noise alone would give."""
    x, direction = run.displacement_mm, run.direction
    edges, index = _stroke_bins(x, n_bins)
    noise = noise_draws(run)
    out = []
    for sign in (1, -1):
        label = np.where(counted(run) & (direction == sign), index, -1)
        weights, present = _means(label)
        low, high = np.quantile(weights @ noise.T, (0.05, 0.95), axis=1)
        centre = 0.5 * (edges[:-1] + edges[1:])[present]
        out.append(StrokeProfile(run.number, sign, centre, weights @ residual(run), low, high))
    return out[0], out[1]


def noise_draws(run: RunData, n_shifts: int = N_SHIFTS) -> FloatArray:
    """Noise-only residuals from the posterior predictive, shape (m n_shifts, n).

    The fitted noise is stationary, so each draw may be moved in time to give several.
    """
    noise = run.predicted_kN - run.law_kN
    steps = np.linspace(0, noise.shape[1], n_shifts, endpoint=False).astype(int)
    return np.concatenate([np.roll(noise, step, axis=1) for step in steps])


def structure(device: DeviceData, *, seed: int = 0) -> Structure:
    """Compare the residual of all runs with noise.

    Parameters
    ----------
    device : DeviceData
    seed : int
        For the sign flips.

    Returns
    -------
    Structure
    """
    observed, reference = [], []
    for run in device.runs:
        weights = _features(run)
        observed.append(weights @ residual(run))
        reference.append(weights @ noise_draws(run).T)
    seen, noise = np.concatenate(observed), np.concatenate(reference)
    scale = noise.std(axis=1)
    z_seen, z_noise = np.abs(seen / scale), np.abs(noise / scale[:, None])
    # Two measures of size: one large place, or many places a little too large.
    p_largest = _share_above(z_noise.max(axis=0), float(z_seen.max()))
    p_typical = _share_above(np.sqrt((z_noise**2).mean(axis=0)), float(np.sqrt((z_seen**2).mean())))
    memory, independent = _memory(device)
    return Structure(
        p_noise=min(1.0, 2 * min(p_largest, p_typical)),
        p_repeat=repeat_p(device, seed=seed),
        memory_s=memory,
        shortest_cycle_s=_shortest_cycle(device),
        independent_noise=independent,
        size=_sizes(device),
        largest=_largest(device),
    )


def _share_above(reference: FloatArray, seen: float) -> float:
    """P value: share of the reference at least as large, the measured one counted in."""
    return float((1 + np.sum(reference >= seen)) / (1 + reference.size))


def repeat_p(device: DeviceData, *, seed: int = 0) -> float | None:
    """P value of "the residual does not come again from cycle to cycle", by flipping signs of whole cycles.

    Returns
    -------
    float or None
        None when there are too few cycles.
    """
    rows, n_features = [], 0
    for run in device.runs:
        label, n = _repeating_labels(run)
        marks = cycle_marks(run)
        cycle = np.searchsorted(marks, np.arange(run.time_s.size), side="right") - 1
        inside = (cycle >= 0) & (cycle < marks.size - 1) & (label >= 0)
        sums = np.zeros((max(marks.size - 1, 0), n))
        np.add.at(sums, (cycle[inside], label[inside]), residual(run)[inside])
        rows.append((n_features, sums))
        n_features += n
    n_cycles = sum(sums.shape[0] for _, sums in rows)
    if n_cycles < MIN_CYCLES:
        return None
    table = np.zeros((n_cycles, n_features))
    at = 0
    for column, sums in rows:
        table[at : at + sums.shape[0], column : column + sums.shape[1]] = sums
        at += sums.shape[0]
    table = table[:, (table != 0).sum(axis=0) >= MIN_CYCLES]
    if table.shape[1] == 0:
        return None
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(N_FLIPS, n_cycles))
    size = np.sqrt((table**2).sum(axis=0))
    seen = float(np.max(np.abs(table.sum(axis=0)) / size))
    flipped = np.max(np.abs(signs @ table) / size, axis=1)
    return float((1 + np.sum(flipped >= seen)) / (1 + N_FLIPS))


def _features(run: RunData) -> sparse.csr_array:
    """Binned means as one sparse matrix: stroke and distance since reversal by direction, and half-cycles in time."""
    keep, direction = counted(run), run.direction
    stroke, _ = _repeating_labels(run)
    per = max(1, int(np.ceil((run.half_cycle.max() + 1) / N_TIME)))
    time = np.where(keep, run.half_cycle // per, -1)
    plain, signed = _means(time)[0], _means(time, direction)[0]
    return sparse.csr_array(sparse.vstack([_means(stroke)[0], _means(_start_labels(run))[0], plain, signed]))


def _repeating_labels(run: RunData) -> tuple[IntArray, int]:
    """Stroke bin by direction of each counted sample (else -1), and the number of bins."""
    index = _stroke_bins(run.displacement_mm, N_STROKE)[1] + N_STROKE * (run.direction > 0)
    return np.where(counted(run), index, -1).astype(np.int64), 2 * N_STROKE


def _stroke_bins(x: FloatArray, n_bins: int) -> tuple[FloatArray, IntArray]:
    """Edges of even bins over the stroke, mm, and the bin of each sample."""
    edges = np.linspace(float(x.min()), float(x.max()), n_bins + 1)
    return edges, np.clip(np.digitize(x, edges) - 1, 0, n_bins - 1).astype(np.int64)


def _start_labels(run: RunData) -> IntArray:
    """Bin of the distance since reversal by direction: even in number of samples, finest near the reversal."""
    keep = counted(run)
    distance = np.abs(run.displacement_mm - run.displacement_mm[run.starts][run.half_cycle - run.half_cycle[0]])
    edges = np.unique(np.quantile(distance[keep], np.linspace(0, 1, N_START + 1)[1:-1]))
    return np.where(keep, np.digitize(distance, edges) + N_START * (run.direction > 0), -1).astype(np.int64)


def _means(label: IntArray, sign: IntArray | None = None) -> tuple[sparse.csr_array, IntArray]:
    """Matrix that takes the mean over the samples of each label (those of -1 left out), and the labels present."""
    inside = np.flatnonzero(label >= 0)
    present, row, count = np.unique(label[inside], return_inverse=True, return_counts=True)
    value = (1.0 if sign is None else sign[inside]) / count[row]
    return sparse.csr_array((value, (row, inside)), shape=(present.size, label.size)), present


def _memory(device: DeviceData) -> tuple[float, bool]:
    """Correlation time of the fitted noise, s, and whether the noise was taken as independent."""
    if "phi" not in device.draws:
        return 0.0, True
    phi = float(np.median(device.draws["phi"]))
    rate = min(run.rate_Hz for run in device.runs)
    return (float(-1 / (rate * np.log(phi))) if phi > 1e-6 else 0.0), False


def _shortest_cycle(device: DeviceData) -> float:
    """Duration of the shortest cycle of all runs, s; twice the mean half-cycle where there is no full cycle."""
    shortest = []
    for run in device.runs:
        marks = np.interp(cycle_marks(run), np.arange(run.time_s.size), run.time_s)
        whole = float(np.ptp(run.time_s)) / (run.reversals.size + 1) * 2
        shortest.append(float(np.diff(marks).min()) if marks.size else whole)
    return min(shortest)


def _sizes(device: DeviceData) -> Size:
    parts = [residual(run)[run.used] for run in device.runs]
    r = np.concatenate(parts)
    step = np.concatenate([np.diff(part) for part in parts])
    product = np.concatenate([part[1:] * part[:-1] for part in parts])
    rms = float(np.sqrt(np.mean(r**2)))
    # Median-based, so that the jumps at reversals do not count as scatter.
    short = float(1.4826 * np.median(np.abs(step)) / np.sqrt(2))
    return Size(rms, short, float(np.mean(product) / rms**2))


def _largest(device: DeviceData) -> Place:
    """Find the largest mean residual over stroke, measured with its noise."""
    best: tuple[float, StrokeProfile, int] | None = None
    for run in device.runs:
        for profile in stroke_profiles(run):
            spread = np.maximum(0.5 * (profile.high_kN - profile.low_kN), 1e-12)
            at = int(np.argmax(np.abs(profile.mean_kN) / spread))
            excess = float(np.abs(profile.mean_kN[at]) / spread[at])
            if best is None or excess > best[0]:
                best = (excess, profile, at)
    assert best is not None
    _, profile, at = best
    run = next(run for run in device.runs if run.number == profile.run)
    sliding = float(np.median(device.draws["Fy"]))
    x, middle = float(profile.centre_mm[at]), 0.5 * float(run.displacement_mm.max() + run.displacement_mm.min())
    out = abs(x - middle) / max(0.5 * float(np.ptp(run.displacement_mm)), 1e-12)
    where = "part-way along the stroke" if out > 0.3 else "near mid-stroke"
    where = "near the end of the stroke" if out > 0.75 else where
    size = float(profile.mean_kN[at])
    return Place(size, abs(size) / sliding, x, profile.run, profile.direction, where)
