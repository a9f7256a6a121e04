"""The law with physical effects: Eq. (1) and (2) plus whatever a list of effects contributes."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, combine
from shj_bayes.model.effects.kernel import limit_rise, rate_free_force
from shj_bayes.model.history import History, delayed
from shj_bayes.model.parameters import FloatArray

LEAST = 1e-3  # of the clamping: effects that take more than all of it leave this


def force_with_effects(
    history: History,
    base: Base,
    effects: Sequence[Effect],
    values: Mapping[str, Mapping[str, float]],
    *,
    variant: str = "published",
    start_force_kN: float = 0.0,
    acted: dict[Hashable, Contribution] | None = None,
) -> FloatArray:
    """Force of one run with effects.

    Parameters
    ----------
    history : History
        The run.
    base : Base
        K, Fy of this run, beta, gamma.
    effects : sequence of Effect
        What is added to the base law; none gives `shj_bayes.model.law.force`.
    values : mapping of effect id to mapping of parameter name to value
        In the units of each effect.
    variant : {"published", "continuous"}
        Reversal rule of the base law.
    start_force_kN : float
        Rate-free force at the first sample, kN.
    acted : dict, optional
        Contributions to this run that are known, to take from and to add to: parameter sets often share most values.

    Returns
    -------
    array, shape (n_samples,)
        Force, kN.
    """
    lag_s = sum(values[effect.id][effect.delay] for effect in effects if effect.delay)
    late = delayed(history, lag_s) if lag_s else None
    # The law on the motion of a moment ago: the force itself has corners that thinning would cut.
    moved, own = late or history.turned
    acted = {} if acted is None else acted
    parts = []
    for effect in effects:
        key = (effect.id, lag_s, base, *values[effect.id].values())
        if key not in acted:
            acted[key] = effect.act(moved, values[effect.id], base)
        parts.append(acted[key])
    total = combine(parts)
    clamping = np.maximum(np.broadcast_to(total.clamping, moved.time_s.shape), LEAST)
    if np.ndim(total.clamping):
        limit_rise(clamping, moved.travel_m, moved.motion.start, 1000.0 * base.K / base.Fy)
    if start_force_kN:  # as it was read: the state of the device is without what is added to it
        start_force_kN -= float(np.ravel(total.added_kN)[0])
    share, gap, stiffness = total.second_surface
    smooth = 1.0 if variant == "continuous" else total.smooth_reversal
    first, second = (1.0 - share, 0.0, 1.0 - share, smooth), (share, gap, stiffness * share, smooth)
    force = _surface(moved, base, total, clamping, first, start_force_kN * (1.0 - share))
    if share > 0:
        force = force + _surface(moved, base, total, clamping, second, start_force_kN * share)
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
    start_force: float,
) -> FloatArray:
    """Rate-free force of one sliding surface that carries a share of capacity and of stiffness behind a gap."""
    share, gap, stiffness, smooth = surface
    motion = history.motion
    out = np.empty(motion.displacement_mm.size)
    rate_free_force(
        out,
        motion.displacement_mm,
        motion.start,
        motion.turning_mm,
        motion.direction,
        np.array([base.K * stiffness, base.Fy * share, base.beta]),
        clamping,
        np.array(
            [
                total.slack_mm + gap,
                total.take_up_mm,
                total.compliance_mm_per_kN / max(share, 1e-12),
                smooth,
                total.open_at_start,
            ]
        ),
        start_force,
    )
    return out
