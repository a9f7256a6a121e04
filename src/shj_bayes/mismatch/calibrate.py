"""Is there more in a residual than noise: the largest studentised score, calibrated by flipping whole cycles.

Samples are not independent, so nothing here counts them. Each cycle gives one score per direction looked into; under
"nothing is missing" the scores are symmetric around 0, so flipping the sign of whole cycles at random gives what the
largest of all statistics does by chance, whatever the noise is like inside a cycle and however many directions are
tried (DOMAIN 3.2, 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Refit, orthogonal_to
from shj_bayes.model.parameters import FloatArray

N_FLIPS = 1999


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
