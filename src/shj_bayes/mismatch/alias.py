"""Before any force is read: which effects the displacement history alone cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.inference.squares import orthogonal_to
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import View, extend_starts, linearise
from shj_bayes.mismatch.thresholds import ALIAS
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.parameters import FloatArray

HIDDEN = 0.1  # share of an effect that must survive a refit of the base law for the history to show it at all


@dataclass(frozen=True)
class Alias:
    """Two effects that look alike under this displacement history; one alone when the base law swallows it.

    Parameters
    ----------
    pair : tuple of str
        Effect ids; the second is ``base law`` for an effect that the base parameters absorb.
    correlation : float
        Cosine between what the base law leaves of both; for ``base law`` the share that it takes.
    """

    pair: tuple[str, str]
    correlation: float


def alias_table(evidence: Evidence, device: DeviceModel, effects: Sequence[Effect]) -> list[Alias]:
    """Pairs that this displacement history cannot separate.

    The law is evaluated at K, Fy, beta that make a plain loop of the tested stroke; no force is used.

    Parameters
    ----------
    evidence : Evidence
        Only its displacement history is used.
    device : DeviceModel
        Model without effects; its priors give the scale of the parameters.
    effects : sequence of Effect
        The catalogue, with ``velocity``.

    Returns
    -------
    list of Alias
        Strongest first.
    """
    base = replace(device, speed=False)
    capacity = device.priors.of("Fy").distribution.median()
    plain = {"Fy": capacity, "K": capacity / (0.1 * evidence.histories[0].half_stroke_mm), "beta": 10.0}
    z = base.unbounded(np.array([[plain.get(name, 0.9) for name in base.names]]))[0, : base.n_law]
    fit = linearise(evidence, base, z)
    left: dict[str, FloatArray] = {}
    out = []
    for effect in effects:
        model = base.with_effects((effect,))
        starts = extend_starts(fit, model, effect)
        start = starts[len(starts) // 2]
        change = (View(evidence, model).force(start) - fit.force_kN) * evidence.weight
        rest = orthogonal_to(fit.jacobian, change[:, None])[:, 0]
        size, whole = float(np.linalg.norm(rest)), float(np.linalg.norm(change))
        if size <= HIDDEN * whole:
            out.append(Alias((effect.id, "base law"), 1.0 - size / max(whole, 1e-300)))
        else:
            left[effect.id] = rest / size
    names = list(left)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            cosine = float(left[first] @ left[second])
            if abs(cosine) > ALIAS:
                out.append(Alias((first, second), cosine))
    return sorted(out, key=lambda alias: -abs(alias.correlation))
