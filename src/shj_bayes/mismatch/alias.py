"""Which effects a displacement history alone cannot tell apart."""

import numpy as np

from shj_bayes.inference.squares import extended, orthogonal_to
from shj_bayes.mismatch.scene import Scene
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.diagnosis import Alias

HIDDEN = 0.1  # share of an effect that must survive a refit of the base law for the history to show it at all
ALIKE = 0.9  # cosine above which two effects look alike


def aliases_of(scene: Scene) -> list[Alias]:
    """Pairs of effects that the tested history cannot separate, strongest first.

    Each effect acts with the values that a search starts from on the base law with the parameters of the device.
    """
    device = scene.device.with_effects(())
    z = scene.z[: device.n_law]
    before = scene.force(device, z[None])[0]
    slopes = scene.jacobian(device, z, scene.residual(device, z[None])[0]) * scene.used[:, None]
    left: dict[str, FloatArray] = {}
    out = []
    for effect in catalogue().values():
        if effect.form or effect.id == "velocity":
            continue
        model = device.with_effects((effect,))
        starts = extended(z, device, model, effect)
        change = scene.force(model, starts[len(starts) // 2][None])[0] - before
        rest = orthogonal_to(slopes, change[:, None])[:, 0]
        size, whole = float(np.linalg.norm(rest)), float(np.linalg.norm(change))
        if size <= HIDDEN * whole or whole == 0.0:
            out.append(Alias((effect.id, "base law"), 1.0 - size / max(whole, 1e-300)))
        else:
            left[effect.id] = rest / size
    names = list(left)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            cosine = float(left[first] @ left[second])
            if abs(cosine) > ALIKE:
                out.append(Alias((first, second), cosine))
    return sorted(out, key=lambda alias: -abs(alias.correlation))
