"""How much of what is more than noise a model takes up."""

from __future__ import annotations

import numpy as np

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Refit, View
from shj_bayes.model.parameters import FloatArray


def share(evidence: Evidence, fine: Evidence, base: Refit, before: Refit, after: Refit) -> float:
    """Share of the misfit of the base law that going from one model to another takes up.

    Parameters
    ----------
    evidence, fine : Evidence
        The recordings, and the same with more samples: a ripple that is shorter than the distance between samples looks
        like noise.
    base : Refit
        The law without effects: its misfit above the noise floor is the whole.
    before, after : Refit
        The smaller and the larger model.

    Returns
    -------
    float
        0 to 1; the noise floor is that of the larger model.
    """
    end = after.rmse_kN**2
    close = View(fine, after.model).residual(after.z)
    floor = min(noise_variance(evidence, after.residual_kN), noise_variance(fine, close), end)
    return float(max(before.rmse_kN**2 - end, 0.0) / max(base.rmse_kN**2 - floor, 1e-300))


def noise_variance(evidence: Evidence, residual: FloatArray) -> float:
    """Stationary variance of AR(1) noise with the residual's short-term scatter and correlation, kN^2.

    Smooth structure looks like strongly correlated noise, so the correlation counts up to 0.8 only: structure must not
    pass for noise, and where noise is more correlated than that the misfit is merely overrated.
    """
    follows = (evidence.weight[1:] > 0) & (evidence.weight[:-1] > 0)
    step = np.diff(residual)[follows]
    phi = float(np.clip(np.corrcoef(residual[:-1][follows], residual[1:][follows])[0, 1], 0.0, 0.8))
    return float(np.median(step**2) / 0.4549 / (2 * (1 - phi)))
