"""What was held possible before the test: loops of the prior beside those of the paper and of the posterior."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from shj_bayes.model.law import BETA_RANGE, force_of_laws
from shj_bayes.model.parameters import FloatArray
from shj_bayes.population.device import published_rows
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.results.device import DeviceData

LAW = ("K", "Fy", "beta", "gamma")
N_PRIOR, N_SHOWN, N_POSTERIOR = 1000, 80, 20
SAMPLES_PER_CYCLE = 240


@dataclass(frozen=True, eq=False)
class Beforehand:
    """One steady sine cycle under prior, paper and posterior."""

    amplitude_mm: float
    peak_speed_mm_s: float
    displacement_mm: FloatArray = field(repr=False)  # shape (n,): a closed loop
    # prior_kN to posterior_kN: shape (m, n): forces; ``paper_kN`` has no rows when the priors are not those of the
    # paper's kind of device
    prior_kN: FloatArray = field(repr=False)
    paper_kN: FloatArray = field(repr=False)
    posterior_kN: FloatArray = field(repr=False)
    # prior_range_kN, posterior_range_kN: 5 and 95 % of the largest force
    prior_range_kN: tuple[float, float]
    posterior_range_kN: tuple[float, float]
    paper_range_kN: tuple[float, ...]  # smallest and largest of the published devices; empty without them
    paper_inside: int  # published loops whose largest force lies within the central 98 % of the prior of their run


def beforehand(device: DeviceData, amplitude_mm: float, peak_speed_mm_s: float) -> Beforehand:
    """Loops of one sine cycle of the amplitude and peak speed that were tested."""
    variant = device.record.model.variant
    published = device.record.model.priors == "afc"
    prior, paper, inside = [], [], 0
    for run in _runs(device):
        # A second run has its own prior: that of the ratio widens that of the sliding force.
        x, force = steady_cycle(_laws(device.prior, N_PRIOR, run), amplitude_mm, peak_speed_mm_s, variant)
        prior.append(force)
        if published:
            _, loops = steady_cycle(_published_laws(run), amplitude_mm, peak_speed_mm_s, variant)
            low, high = np.quantile(np.abs(force).max(axis=1), (0.01, 0.99))
            reached = np.abs(loops).max(axis=1)
            inside += int(np.sum((reached >= low) & (reached <= high)))
            paper.append(loops)
    draws = {name: values.ravel() for name, values in device.draws.items()}
    after = [_laws(draws, N_POSTERIOR, run) for run in _runs(device)]
    _, posterior = steady_cycle(np.concatenate(after), amplitude_mm, peak_speed_mm_s, variant)
    before = np.concatenate(prior)
    loops = np.concatenate(paper) if paper else np.empty((0, x.size))
    return Beforehand(
        amplitude_mm,
        peak_speed_mm_s,
        x,
        before[:: max(1, before.shape[0] // N_SHOWN)],
        loops,
        posterior,
        _range(before, (0.05, 0.95)),
        _range(posterior, (0.05, 0.95)),
        _range(loops, (0.0, 1.0)) if paper else (),
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


def _runs(device: DeviceData) -> tuple[int, ...]:
    return (1, 2) if "ratio" in device.draws else (1,)


def _range(force_kN: FloatArray, levels: tuple[float, float]) -> tuple[float, float]:
    """Two quantiles of the largest force of each loop, kN."""
    low, high = np.quantile(np.abs(force_kN).max(axis=1), levels)
    return float(low), float(high)


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
    rows = [[row.values[name, run] for name in ("K", "Fy", "beta", "dep")] for row in published_rows()]
    laws = np.array(rows)
    laws[:, 3] = 1 / laws[:, 3]
    return laws
