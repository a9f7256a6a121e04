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

from dataclasses import dataclass

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.binned import StrokeProfile, features, noise_means, repeating_labels, residual, stroke_profiles
from shj_bayes.report.data import DeviceData
from shj_bayes.report.numbers import cycle_marks
from shj_bayes.report.words import LONG_MEMORY

N_FLIPS = 1999
MIN_CYCLES = 8  # fewer cycles cannot reach a p value below 1 %
LEVEL = 0.01  # of each look; both together raise a false alarm for about 3 devices in 100 (tests/report)
FEWEST_CYCLES = 3  # what comes again twice may be shape; what is there once or twice may be chance
POOR_PERCENT = 5.0  # of Fy: more than nominally identical devices differ by
LARGE_SLOW = 0.02  # of Fy: a load cell's own drift stays below


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
    memory_s, typical_cycle_s : float
        Correlation time of the fitted noise (0 without correlation) and median duration of a cycle.
    independent_noise : bool
        True when the fit took the noise as independent.
    size : Size
        How large the residual is.
    largest : Place
        Where it stands out most.
    n_cycles : int
        Full cycles of all runs.
    unexplained_percent : float
        Root mean square of the residual beyond the scatter from one sample to the next, per cent of the sliding force.
    """

    p_noise: float
    p_repeat: float | None
    memory_s: float
    typical_cycle_s: float
    independent_noise: bool
    size: Size
    largest: Place
    n_cycles: int
    unexplained_percent: float

    @property
    def grade(self) -> str:
        """Of the model: ``good``, ``fair``, ``poor``, or ``undecided`` where there are too few cycles to say."""
        if self.n_cycles < FEWEST_CYCLES:
            return "undecided"
        if self.unexplained_percent > POOR_PERCENT:
            return "poor"
        return "fair" if self.structured else "good"

    @property
    def least_cycles(self) -> int:
        """Full cycles that a verdict on the model needs."""
        return FEWEST_CYCLES

    @property
    def absorbed(self) -> bool:
        """True when the noise model has a memory comparable with the cycles."""
        return self.memory_s > LONG_MEMORY * self.typical_cycle_s

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
        weights = features(run)
        observed.append(weights @ residual(run))
        reference.append(noise_means(run, weights))
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
        typical_cycle_s=_typical_cycle(device),
        independent_noise=independent,
        size=_sizes(device),
        largest=_largest(device),
        n_cycles=sum(max(0, cycle_marks(run).size - 1) for run in device.runs),
        unexplained_percent=_unexplained(device),
    )


def _unexplained(device: DeviceData) -> float:
    """Residual that neighbouring samples share, root mean square in per cent of the sliding force."""
    size, capacity = _sizes(device), abs(float(np.median(device.draws["Fy"])))
    return 100.0 * float(np.sqrt(max(size.rms_kN**2 - size.short_kN**2, 0.0))) / max(capacity, 1e-12)


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
        label, n = repeating_labels(run)
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


def _memory(device: DeviceData) -> tuple[float, bool]:
    """Correlation time of noise that is large enough to hide a misfit, s, and whether the noise was taken as white."""
    middle = {name: float(np.median(values)) for name, values in device.draws.items()}
    if "tau_slow" in middle:
        return (middle["tau_slow"] if middle["sigma_slow"] > LARGE_SLOW * middle["Fy"] else 0.0), False
    if "phi" not in middle:
        return 0.0, True
    rate = min(run.rate_Hz for run in device.runs)
    return (float(-1 / (rate * np.log(middle["phi"]))) if middle["phi"] > 1e-6 else 0.0), False


def _typical_cycle(device: DeviceData) -> float:
    """Median duration of the cycles of all runs, s; twice the mean half-cycle where there is no full cycle."""
    durations: list[float] = []
    for run in device.runs:
        marks = np.interp(cycle_marks(run), np.arange(run.time_s.size), run.time_s)
        whole = float(np.ptp(run.time_s)) / (run.reversals.size + 1) * 2
        durations += np.diff(marks).tolist() if marks.size > 1 else [whole]
    return float(np.median(durations))


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
