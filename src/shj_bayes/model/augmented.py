"""The law with physical effects: Eq. (1) and (2) plus whatever a list of effects contributes."""

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from shj_bayes.model.effects.effect import LEAST, Base, Contribution, Effect, combine
from shj_bayes.model.effects.kernel import limit_rise, rate_free_force
from shj_bayes.model.history import History, delayed
from shj_bayes.model.parameters import FloatArray

UNLOADED = 0.1  # of the sliding force: a test that begins with less than this begins unloaded


def force_with_effects(
    history: History,
    base: Base,
    acting: Sequence[tuple[Effect, Mapping[str, float]]],
    *,
    variant: str = "published",
    start_force_kN: float = 0.0,
    acted: dict[Hashable, Contribution] | None = None,
) -> FloatArray:
    """Force of one run with effects, shape (n_samples,), kN; without any that of `shj_bayes.model.law`.

    Each effect is `acting` with the values of its parameters by name, in their units. The rate-free force at the first
    sample is given. `acted` holds contributions to this run that are known, to take from and to add to:
    parameter sets often share most values.
    """
    lag_s = sum(values[effect.delay] for effect, values in acting if effect.delay)
    late = delayed(history, lag_s) if lag_s else None
    # The law on the motion of a moment ago: the force itself has corners that thinning would cut.
    moved, own = late or history.turned
    acted = {} if acted is None else acted
    parts = []
    for effect, values in acting:
        key = (effect.id, lag_s, base, *values.values())
        if key not in acted:
            acted[key] = effect.act(moved, values, base)
        parts.append(acted[key])
    total = combine(parts)
    clamping = np.maximum(np.broadcast_to(total.clamping, moved.time_s.shape), LEAST)
    if np.ndim(total.clamping):
        limit_rise(clamping, moved.travel_m, moved.motion.start, 1000.0 * base.K / base.Fy)
    if start_force_kN:  # as it was read: the state of the device is without what is added to it
        start_force_kN -= float(np.ravel(total.added_kN)[0])
    share, gap, stiffness = total.second_surface
    smooth = 1.0 if variant == "continuous" else total.smooth_reversal
    force = _surface(moved, base, total, clamping, (1.0 - share, 0.0, 1.0 - share, smooth), start_force_kN)
    if share > 0:
        second = (share, gap, stiffness * share, smooth)
        force = force + _surface(moved, base, total, clamping, second, start_force_kN)
    force = force * (1.0 + (base.gamma + total.gamma_s_per_mm) * moved.speed_mm_s) + total.added_kN
    force = force[own]
    if lag_s and late is None:
        force = np.interp(history.time_s - lag_s, history.time_s, force)
    return np.asarray(force)


def _surface(
    history: History,
    base: Base,
    total: Contribution,
    clamping: FloatArray,
    surface: tuple[float, float, float, float],
    start_force_kN: float,
) -> FloatArray:
    """Rate-free force of one sliding surface that carries a share of capacity and of stiffness behind a gap."""
    share, gap, stiffness, smooth = surface
    motion = history.motion
    compliance = total.compliance_mm_per_kN / max(share, 1e-12)
    if total.slack_mm + gap > 0.0 and abs(start_force_kN) < UNLOADED * base.Fy * clamping[0]:
        start_force_kN = 0.0  # read as a little more or less: the device is in its clearance, not beyond one end of it
    law = np.array([base.K * stiffness, base.Fy * share, base.beta])
    added = np.array([total.slack_mm + gap, total.take_up_mm, compliance, smooth, total.open_at_start])
    out, of_motion = np.empty(motion.displacement_mm.size), (motion.start, motion.turning_mm, motion.direction)
    rate_free_force(out, motion.displacement_mm, *of_motion, law, clamping, added, start_force_kN * share)
    return out
