"""What a model predicts for cycles that it was not fitted to."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shj_bayes.inference.floor import cycles_through
from shj_bayes.mismatch.scene import Metric, Scene
from shj_bayes.mismatch.state import State
from shj_bayes.model.parameters import FloatArray

FEW_CYCLES = 12  # with fewer cycles than this, half-cycles are left out


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Prediction of each cycle from the others."""

    residual: FloatArray  # shape (n,): of each block under the parameters without its cycle, kN
    # shape (n_cycles,): log predictive density of each cycle, but for a constant that is the same for all models, nats
    log_density: FloatArray

    @property
    def rmse_kN(self) -> float:
        """Root mean square of the held-out residual, kN."""
        return float(np.sqrt(np.mean(self.residual[self.residual != 0.0] ** 2)))


def cycles_of(scene: Scene) -> NDArray[np.int64]:
    """Cycle of each block, counted through all runs; half-cycles where there are few cycles."""
    blocks = [np.diff(part.timing.half) for part in scene.posterior.averages]  # of each half-cycle
    n_half = [own.size for own in blocks]
    cycle = cycles_through(n_half, 2 if sum(n_half) // 2 >= FEW_CYCLES else 1)
    return np.repeat(cycle, np.concatenate(blocks))


def held_out(scene: Scene, metric: Metric, state: State) -> HeldOut:
    """Predict each cycle with the parameters fitted without it, to first order.

    The state in which a test began stays as it is: only its first cycle tells of it. Of the metric the discrepancy is
    left out, as it is no prediction.
    """
    cycles = cycles_of(scene)
    order = scene.used > 0
    white = metric.whitened(np.column_stack([state.residual, state.jacobian]))
    cycle = cycles[order]
    told = state.model.predicted[: state.z.size]
    slopes = white[:, 1:][:, told]
    gram = slopes.T @ slopes + np.eye(slopes.shape[1])
    residual = state.residual.copy()
    edges = [*np.flatnonzero(np.diff(cycle, prepend=-1)).tolist(), cycle.size]
    density = np.empty(len(edges) - 1)
    raw = np.flatnonzero(order)
    for i, (a, b) in enumerate(pairwise(edges)):
        own = slopes[a:b]
        step = np.linalg.lstsq(gram - own.T @ own, own.T @ white[a:b, 0], rcond=1e-10)[0]
        density[i] = -0.5 * float(np.sum((white[a:b, 0] + own @ step) ** 2))
        residual[raw[a:b]] += state.jacobian[raw[a:b]][:, told] @ step
    return HeldOut(residual * scene.used, density)
