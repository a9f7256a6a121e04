"""Is there more in a residual than noise: the largest studentised score, calibrated by flipping whole cycles.

Samples are not independent, so nothing here counts them. Each cycle gives one score per direction looked into; under
"nothing is missing" the scores are symmetric around 0, so flipping the sign of whole cycles at random gives what the
largest of all statistics does by chance, whatever the noise is like inside a cycle and however many directions are
tried (DOMAIN 3.2, 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.inference.squares import orthogonal_to
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Refit
from shj_bayes.model.parameters import FloatArray

N_FLIPS = 1999
NEIGHBOURS = 25  # periodogram lines on each side that give the local background
FREEDOM = (
    10.0  # independent exponentials whose mean is as uncertain as that background: 51 lines, windowed, their median
)


@dataclass(frozen=True, eq=False)
class Alarm:
    """Result of a calibrated look.

    Parameters
    ----------
    p_value : float
        Of "nothing is missing", corrected for every direction tried.
    statistic : array, shape (n_directions,)
        Studentised scores (not signed).
    p_of_each : array, shape (n_directions,)
        The same correction, for each direction by itself.
    share : array, shape (n_directions,)
        Sum of squares of the residual that the direction takes up, as a share of the whole.
    """

    p_value: float
    statistic: FloatArray
    p_of_each: FloatArray
    share: FloatArray


def look(evidence: Evidence, fit: Refit, directions: FloatArray, rng: np.random.Generator) -> Alarm:
    """Compare a residual with many directions at once.

    Parameters
    ----------
    evidence : Evidence
        Gives the cycle blocks.
    fit : Refit
        Its residual is looked at; what its parameters could still follow is taken out of the directions.
    directions : array, shape (n, n_directions)
        Shapes that a missing effect would have.
    rng : numpy.random.Generator
        Source of the flips.

    Returns
    -------
    Alarm
    """
    own = orthogonal_to(fit.jacobian, directions * evidence.weight[:, None])
    size = np.linalg.norm(own, axis=0)
    alive = size > 1e-3 * np.maximum(np.linalg.norm(directions, axis=0), 1e-300)
    own = np.where(alive, own / np.maximum(size, 1e-300), 0.0)
    scores = evidence.block_sums(own * fit.residual_kN[:, None])
    spread = np.sqrt(np.sum(scores**2, axis=0))
    spread = np.where(spread > 0, spread, np.inf)
    statistic = np.abs(scores.sum(axis=0)) / spread
    flips = rng.choice([-1.0, 1.0], size=(N_FLIPS, evidence.n_blocks))
    highest = np.max(np.abs(flips @ scores) / spread, axis=1)
    total = float(fit.residual_kN @ fit.residual_kN) + 1e-300
    each = (1 + np.count_nonzero(highest[:, None] >= statistic[None], axis=0)) / (N_FLIPS + 1)
    return Alarm(
        p_value=float(each.min()),
        statistic=statistic,
        p_of_each=each,
        share=np.asarray(scores.sum(axis=0) ** 2 / total),
    )


def _over_neighbours(power: FloatArray) -> FloatArray:
    """Periodogram over its local background, which the median of the neighbours gives."""
    padded = np.pad(power, NEIGHBOURS, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    return np.asarray(power * np.log(2.0) / np.maximum(np.median(around, axis=1), 1e-300))


@dataclass(frozen=True)
class Line:
    """Strongest line in the periodogram of a residual over time.

    Parameters
    ----------
    p_value : float
        Of so strong a line in noise with a smooth spectrum, corrected for all lines of all runs.
    run : int
        Run in which it is.
    period_s : float
        Its period, s.
    amplitude_kN : float
        Its amplitude, kN.
    """

    p_value: float
    run: int
    period_s: float
    amplitude_kN: float


def strongest_line(evidence: Evidence, fit: Refit) -> Line:
    """Look for a misfit that follows the clock.

    Such a wave shows in no place, no direction and, cycle by cycle, with any sign, so flipping cycles is blind to it.
    Each line of the periodogram is compared with the median of its neighbours, which for noise with a smooth spectrum
    makes it a ratio of exponentials, whatever the correlation (checked for phi from 0 to
    0.99); a drift or a step widens into its neighbours and does not stand out.

    Parameters
    ----------
    evidence : Evidence
        Gives time and runs.
    fit : Refit
        Its residual is looked at.

    Returns
    -------
    Line
    """
    best, n_lines = Line(1.0, 1, 0.0, 0.0), 0
    strongest = 0.0
    for history in evidence.histories:
        own = evidence.run == history.run
        grid = np.linspace(history.time_s[0], history.time_s[-1], history.time_s.size)
        residual = np.interp(grid, history.time_s, fit.residual_kN[own])
        # A window keeps a line in three bins; without it the blocks' own frequencies leak far.
        window = np.hanning(grid.size)
        spectrum = np.fft.rfft(residual * window)[1:]
        power = np.abs(spectrum) ** 2
        if power.size < 4 * NEIGHBOURS:
            continue
        # Noise lies between flat and falling with the square of the frequency: a line stands out of both.
        steep = power * np.arange(1.0, power.size + 1) ** 2
        ratio = np.minimum(_over_neighbours(power), _over_neighbours(steep))
        n_lines += power.size
        top = int(np.argmax(ratio))
        if ratio[top] > strongest:
            strongest = float(ratio[top])
            amplitude = float(2 * np.abs(spectrum[top]) / window.sum())
            best = Line(1.0, history.run, float(history.time_s[-1]) / (top + 1), amplitude)
    return replace(best, p_value=float(min(1.0, n_lines * (1.0 + strongest / FREEDOM) ** -FREEDOM)))
