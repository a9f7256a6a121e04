"""Distance slid since the last reversal: what is left of the slip once the connection has unloaded and loaded again."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray


def slid_mm(history: History, base: Base) -> FloatArray:
    """Slip since the reversal less the elastic part 2 Fy/K (Fy/K at the start of a run), shape (n_samples,), mm."""
    elastic = base.Fy / base.K
    slid = history.slip_mm - 2 * elastic
    slid[: history.motion.start[1]] += elastic
    return np.asarray(np.maximum(slid, 0.0))
