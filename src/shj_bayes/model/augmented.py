"""The law with physical effects: Eq. (1) and (2) plus whatever a list of effects contributes."""

from collections.abc import Hashable, Mapping, Sequence

import numpy as np
from scipy.special import gammainc, gammaincinv

from shj_bayes.model.effects.effect import LEAST, Base, Contribution, Effect, combine
from shj_bayes.model.effects.kernel import at_speed, gone_further, limit_rise, rate_free_force
from shj_bayes.model.history import History, delayed
from shj_bayes.model.parameters import FloatArray

UNLOADED = 0.1  # of the sliding force: a test that begins with less than this begins unloaded
STEPS = 6  # of the response of a filter to a jump of the force
# Delays of a critically damped filter with two poles, in equal shares, as shares of their mean: means of the parts of
# its impulse response, which is that of the gamma law with shape 2, spread as widely as that.
_MEANS = STEPS * np.diff(gammainc(3.0, np.append(gammaincinv(2.0, np.arange(STEPS) / STEPS), np.inf)))
TWO_POLES = 1.0 + (_MEANS - 1.0) * np.sqrt(0.5 / _MEANS.var())


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
    acted = {} if acted is None else acted
    parts = [_late(history, base, acting, lag_s, variant, start_force_kN, acted) for lag_s in _lags_s(acting)]
    return parts[0] if len(parts) == 1 else np.mean(parts, axis=0)


def _lags_s(acting: Sequence[tuple[Effect, Mapping[str, float]]]) -> tuple[float, ...]:
    """Delays of the force channel, in equal shares, s: one, or those of a filter in the steps of its response."""
    whole = filtered = 0.0
    for effect, values in acting:
        if effect.delay:
            share = values[effect.filtered] if effect.filtered else 0.0
            whole += values[effect.delay] * (1.0 - share)
            filtered += values[effect.delay] * share
    return tuple(whole + filtered * TWO_POLES) if filtered else (whole,)


def _late(
    history: History,
    base: Base,
    acting: Sequence[tuple[Effect, Mapping[str, float]]],
    lag_s: float,
    variant: str,
    start_force_kN: float,
    acted: dict[Hashable, Contribution],
) -> FloatArray:
    """Force of one run as it is recorded with a delay, shape (n_samples,), kN."""
    late = delayed(history, lag_s) if lag_s else None
    # The law on the motion of a moment ago: the force itself has corners that thinning would cut.
    moved, own = late or history.turned
    parts = []
    for effect, values in acting:
        key = (effect.id, lag_s, base, *values.values())
        if key not in acted:
            acted[key] = effect.act(moved, values, base)
        parts.append(acted[key])
    total = combine(parts)
    clamping = np.maximum(np.ravel(total.clamping), LEAST)
    if clamping.size > 1:
        motion = moved.motion
        gone = moved.recall("gone further", lambda: np.asarray(gone_further(moved.travel_m, motion.start)))
        limit_rise(clamping, gone, motion.start, 1000.0 * base.K / base.Fy)
    else:
        clamping = np.full(moved.time_s.size, clamping[0])
    if start_force_kN:  # as it was read: the state of the device is without what is added to it
        start_force_kN -= float(np.ravel(total.added_kN)[0])
    share, gap, stiffness = total.second_surface
    smooth = 1.0 if variant == "continuous" else total.smooth_reversal
    force = _surface(moved, base, total, clamping, (1.0 - share, 0.0, 1.0 - share, smooth), start_force_kN)
    if share > 0:
        second = (share, gap, stiffness * share, smooth)
        force = force + _surface(moved, base, total, clamping, second, start_force_kN)
    at_speed(force, moved.speed_mm_s, base.gamma + total.gamma_s_per_mm, np.ravel(total.added_kN))
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
