"""The law with physical effects: Eq. (1) and (2) plus whatever a list of effects contributes."""

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaincinv

from shj_bayes.model.effects.effect import LEAST, Base, Contribution, Effect, combine
from shj_bayes.model.effects.kernel import at_speed, changes_of_force, gone_further, limit_rise, rate_free_force
from shj_bayes.model.history import History, delayed
from shj_bayes.model.parameters import FloatArray

UNLOADED = 0.1  # of the sliding force: a test that begins with less than this begins unloaded
NONE = np.empty((2, 0))
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
    parts = [
        _Late.of(history, base, acting, lag_s, variant, start_force_kN, acted).force() for lag_s in _lags_s(acting)
    ]
    return parts[0] if len(parts) == 1 else np.mean(parts, axis=0)


def slopes_with_effects(
    history: History,
    base: Base,
    acting: Sequence[tuple[Effect, Mapping[str, float]]],
    *,
    variant: str = "published",
    start_force_kN: float = 0.0,
) -> FloatArray:
    """Give the derivatives of the force of one run after the parameters of effects that are linear in theirs, kN.

    Those effects have `Effect.columns`; shape (n_samples, p). All else as for `force_with_effects`.
    """
    known: dict[Hashable, Contribution] = {}
    late = [_Late.of(history, base, acting, lag_s, variant, start_force_kN, known) for lag_s in _lags_s(acting)]
    return np.asarray(np.mean([one.slopes([effect for effect, _ in acting]) for one in late], axis=0))


def _lags_s(acting: Sequence[tuple[Effect, Mapping[str, float]]]) -> tuple[float, ...]:
    """Delays of the force channel, in equal shares, s: one, or those of a filter in the steps of its response."""
    whole = filtered = 0.0
    for effect, values in acting:
        if effect.delay:
            share = values[effect.filtered] if effect.filtered else 0.0
            whole += values[effect.delay] * (1.0 - share)
            filtered += values[effect.delay] * share
    return tuple(whole + filtered * TWO_POLES) if filtered else (whole,)


class _Late(NamedTuple):
    """What acts on the law in one run as it is recorded with a delay."""

    history: History  # as recorded
    moved: History  # of the moment that the force is of
    own: NDArray[np.int64]  # which of its points those of the recording are
    interpolated_s: float  # delay by which the force is read between the points; 0 where the motion is that of then
    base: Base
    parts: tuple[Contribution, ...]  # of each effect
    total: Contribution  # of all of them
    clamping: FloatArray  # shape (n,): as the capacity can rise
    start_force_kN: float  # rate-free force at the first sample, without what is added to it
    surfaces: tuple[tuple[float, float, float, float], ...]  # share, gap, stiffness, continuous rule of each

    @classmethod
    def of(
        cls,
        history: History,
        base: Base,
        acting: Sequence[tuple[Effect, Mapping[str, float]]],
        lag_s: float,
        variant: str,
        start_force_kN: float,
        acted: dict[Hashable, Contribution],
    ) -> Self:
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
            start = moved.motion.start
            gone = moved.recall("gone further", lambda: np.asarray(gone_further(moved.travel_m, start)))
            limit_rise(clamping, gone, start, 1000.0 * base.K / base.Fy)
        else:
            clamping = np.full(moved.time_s.size, clamping[0])
        if start_force_kN:  # as it was read: the state of the device is without what is added to it
            start_force_kN -= float(np.ravel(total.added_kN)[0])
        share, gap, stiffness = total.second_surface
        smooth = 1.0 if variant == "continuous" else total.smooth_reversal
        surfaces = ((1.0 - share, 0.0, 1.0 - share, smooth), (share, gap, stiffness * share, smooth))
        between = lag_s if late is None else 0.0
        both = surfaces[: 2 if share > 0 else 1]
        return cls(history, moved, own, between, base, tuple(parts), total, clamping, start_force_kN, both)

    def force(self) -> FloatArray:
        """Force of the run, shape (n_samples,), kN."""
        force = self._surface(self.surfaces[0])
        for further in self.surfaces[1:]:
            force = force + self._surface(further)
        at_speed(force, self.moved.speed_mm_s, self._gamma, np.ravel(self.total.added_kN))
        return self._recorded(force)

    def slopes(self, effects: Sequence[Effect]) -> FloatArray:
        """Give its derivatives after the parameters of the effects that are linear in theirs, shape (n_samples, p)."""
        n = self.clamping.size
        capacity, added = [], []
        for place, effect in enumerate(effects):
            if effect.columns is None:
                continue
            columns = effect.columns(self.moved, self.base)
            nothing = np.zeros(columns.shape)
            if effect.columns_added:
                capacity.append(nothing)
                added.append(columns)
            else:
                others = combine([part for i, part in enumerate(self.parts) if i != place]).clamping
                capacity.append(columns * np.reshape(others, (-1, 1)))
                added.append(nothing)
        clamping, force = np.concatenate(capacity, axis=1), np.concatenate(added, axis=1)
        wanted = np.broadcast_to(self.total.clamping, n)
        clamping[wanted < LEAST] = 0.0
        limited = self.clamping < np.maximum(wanted, LEAST)
        at_first, speed = force[0].copy(), 1.0 + self._gamma * self.moved.speed_mm_s
        motion = self.moved.motion
        for surface in self.surfaces:
            slopes, at_ends, changes = np.empty((2, n)), np.zeros((2, motion.n_half)), clamping.copy()
            self._surface(surface, slopes, at_ends)
            first = -surface[0] * at_first if self._begins_kN(surface) else np.zeros(at_first.size)
            changes_of_force(changes, first, limited, slopes, at_ends, motion.start)
            force += changes * speed[:, None]
        return np.stack([self._recorded(column) for column in force.T], axis=1)

    @property
    def _gamma(self) -> float:
        return self.base.gamma + self.total.gamma_s_per_mm

    def _recorded(self, force: FloatArray) -> FloatArray:
        """Give the force at the points of `moved` as it is recorded, shape (n_samples,)."""
        if self.interpolated_s:
            time = self.history.time_s
            return np.asarray(np.interp(time - self.interpolated_s, time, force[self.own]))
        return np.asarray(force[self.own])

    def _begins_kN(self, surface: tuple[float, float, float, float]) -> float:
        """Force of a surface at the first sample."""
        share, gap, _, _ = surface
        opens = self.total.slack_mm + gap > 0.0
        if opens and abs(self.start_force_kN) < UNLOADED * self.base.Fy * self.clamping[0]:
            return 0.0  # read as a little more or less: the device is in its clearance, not beyond one end of it
        return self.start_force_kN * share

    def _surface(
        self, surface: tuple[float, float, float, float], slopes: FloatArray = NONE, at_ends: FloatArray = NONE
    ) -> FloatArray:
        """Rate-free force of one sliding surface that carries a share of capacity and of stiffness behind a gap.

        The `slopes` and those `at_ends` as for `rate_free_force`.
        """
        share, gap, stiffness, smooth = surface
        motion, total, base = self.moved.motion, self.total, self.base
        compliance = total.compliance_mm_per_kN / max(share, 1e-12)
        law = np.array([base.K * stiffness, base.Fy * share, base.beta])
        parts = np.array([total.slack_mm + gap, total.take_up_mm, compliance, smooth, total.open_at_start])
        out, x = np.empty(motion.displacement_mm.size), motion.displacement_mm
        of_motion = (motion.start, motion.turning_mm, motion.direction)
        rate_free_force(out, slopes, at_ends, x, *of_motion, law, self.clamping, parts, self._begins_kN(surface))
        return out
