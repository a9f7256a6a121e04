"""The model of one device: the published law, effects that are added to it and the noise, as one parameter vector."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaincinv

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model.curve import curve_named
from shj_bayes.model.effects.effect import LEAST, Base, Contribution, Effect, catalogue, combine
from shj_bayes.model.effects.sliding import at_speed, changes_of_force, gone_further, limit_rise, rate_free_force
from shj_bayes.model.history import History, delayed
from shj_bayes.model.law import force_of_laws, variant_named
from shj_bayes.model.noise import DEFAULT, Noise, noise_model
from shj_bayes.model.parameters import SHAREABLE, Parameter, describe, run_name
from shj_bayes.model.priors import Laws, Priors

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
    own: IntArray  # which of its points those of the recording are
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


@dataclass(frozen=True, eq=False)
class DeviceModel:
    """What is believed of one device before its test: parameters with priors, the force they make, the noise.

    The published law is the one without effects.
    """

    n_runs: int  # consecutive runs of the device, 1 to 9
    priors: Priors  # laws of the base parameters and of the noise
    effects: tuple[Effect, ...] = ()  # what is added to the base law
    noise: Noise = field(default_factory=lambda: noise_model(DEFAULT))  # noise model; white and slow by default
    # those of K, beta, gamma that each run has for itself (``K_2`` for the second run); the others are shared
    free: tuple[str, ...] = ()
    variant: str = "published"  # "published", "continuous": reversal rule
    speed: bool = True  # False fixes gamma at 0

    def __post_init__(self) -> None:
        """Refuse choices that no device could have."""
        if not 1 <= self.n_runs <= 9:
            raise ModelError(f"a device has {self.n_runs} runs; allowed are 1 to 9 consecutive runs")
        object.__setattr__(self, "variant", variant_named(self.variant))
        wrong = [name for name in self.free if name not in SHAREABLE]
        if wrong:
            hint = did_you_mean(wrong[0], SHAREABLE)
            raise ModelError(f"'{wrong[0]}' cannot be freed between runs; allowed are {', '.join(SHAREABLE)}{hint}")
        twice = [e.id for i, e in enumerate(self.effects) if e.id in [other.id for other in self.effects[:i]]]
        if twice:
            raise ModelError(f"effect '{twice[0]}' is named twice; name each effect once")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in order: law, ratios, freed parameters, those of the effects (``slack.size``), noise."""
        runs = range(2, self.n_runs + 1)
        law = [name for name in ("K", "Fy", "beta", "gamma") if self.speed or name != "gamma"]
        ratios = [run_name("ratio", run) for run in runs]
        freed = [f"{name}_{run}" for run in runs for name in SHAREABLE if name in self.free and name in law]
        added = [f"{effect.id}.{prior.name}" for effect in self.effects for prior in effect.parameters]
        return (*law, *ratios, *freed, *added, *self.noise.parameters)

    @cached_property
    def laws(self) -> Laws:
        """Prior of each sampled parameter."""
        own = {f"{effect.id}.{prior.name}": prior for effect in self.effects for prior in effect.parameters}
        return Laws(own[name] if name in own else self.priors.of(name) for name in self.names)

    @property
    def n_law(self) -> int:
        """Number of parameters that the force depends on: all but those of the noise, which come last."""
        return len(self.names) - len(self.noise.parameters)

    @property
    def law_names(self) -> tuple[str, ...]:
        """Parameters that the force depends on."""
        return self.names[: self.n_law]

    def law_values(self, z: FloatArray) -> dict[str, float]:
        """Parameters of the force in natural units by name, from their unbounded values, shape (n_law,)."""
        pairs = zip(self.law_names, self.laws, z, strict=False)
        return {name: float(prior.from_free(np.asarray(value))) for name, prior, value in pairs}

    @cached_property
    def predicted(self) -> BoolArray:
        """For each parameter, whether other cycles tell of it: not of the state in which a test began, shape (d,)."""
        initial = {f"{effect.id}.{name}" for effect in self.effects for name in effect.initial}
        return np.array([name not in initial for name in self.names])

    def with_effects(self, effects: Sequence[Effect]) -> DeviceModel:
        """Give the same device with other effects."""
        return replace(self, effects=tuple(effects))

    def run_laws(self, theta: FloatArray, run: int) -> FloatArray:
        """K (kN/mm), Fy of that run (kN), beta and gamma (s/mm) of parameter sets, shape (m, d) to (m, 4)."""
        at = {
            name: self.names.index(f"{name}_{run}" if run > 1 and name in self.free else name)
            for name in SHAREABLE
            if self.speed or name != "gamma"
        }
        gamma = theta[:, at["gamma"]] if self.speed else np.zeros(theta.shape[0])
        capacity = theta[:, self.names.index("Fy")]
        if run > 1:
            capacity = capacity * theta[:, self.names.index(run_name("ratio", run))]
        return np.ascontiguousarray(np.stack([theta[:, at["K"]], capacity, theta[:, at["beta"]], gamma], axis=1))

    def acting(self, theta: FloatArray, run: int) -> Iterator[tuple[Base, list[tuple[Effect, dict[str, float]]]]]:
        """Law of a run and the effects with their values, for each of some parameter sets, shape (m, d)."""
        laws, place = self.run_laws(theta, run).tolist(), {name: i for i, name in enumerate(self.names)}
        places = [(e, [(p.name, place[f"{e.id}.{p.name}"]) for p in e.parameters]) for e in self.effects]
        for own, (stiffness, capacity, beta, gamma) in zip(theta.tolist(), laws, strict=True):
            base = Base(stiffness, capacity, beta, gamma, own[place["Fy"]])
            yield base, [(effect, {name: own[i] for name, i in at}) for effect, at in places]

    def force(self, theta: FloatArray, history: History, start_force_kN: float) -> FloatArray:
        """Force of one run without noise, kN, for parameter sets in natural units, shape (m, d) to (m, n_samples).

        The rate-free force at the first sample of the run is given.
        """
        if not self.effects:
            laws = self.run_laws(theta, history.run)
            return force_of_laws(history.motion, laws, variant=self.variant, start_force_kN=start_force_kN)
        out = np.empty((theta.shape[0], history.time_s.size))
        acted: dict[Hashable, Contribution] = {}
        for j, (base, acting) in enumerate(self.acting(theta, history.run)):
            out[j] = force_with_effects(
                history, base, acting, variant=self.variant, start_force_kN=start_force_kN, acted=acted
            )
        return out

    def noise_values(self, theta: FloatArray) -> dict[str, FloatArray]:
        """Noise parameters by name, each of shape (m,)."""
        return {name: np.ascontiguousarray(theta[:, self.names.index(name)]) for name in self.noise.parameters}


def linear_in(model: DeviceModel) -> NDArray[np.intp]:
    """Places of the parameters that belong to effects which are linear in theirs, shape (p,): those of `slopes_of`."""
    of = {f"{e.id}.{name}" for e in model.effects if e.columns for name in e.names}
    return np.flatnonzero([name in of for name in model.names])


def slopes_of(model: DeviceModel, theta: FloatArray, history: History, start_force_kN: float) -> FloatArray:
    """Give the derivatives of the force of one run after the parameters `linear_in` it, shape (d,) to (n_samples, p).

    In the unbounded space, kN; other arguments as for `DeviceModel.force`.
    """
    ((base, acting),) = model.acting(theta[None], history.run)
    own = slopes_with_effects(history, base, acting, variant=model.variant, start_force_kN=start_force_kN)
    return own * model.laws.spread[linear_in(model)]


def meaning_of(name: str) -> Parameter:
    """Give unit and meaning of any sampled parameter: of the law, of the noise, or of an effect (``slack.size``)."""
    owner, dot, own = name.partition(".")
    if not dot:
        return describe(name)
    effect = effect_named(owner)
    prior = next((prior for prior in effect.parameters if prior.name == own), None)
    if prior is None:
        raise ModelError(f"'{name}' is not a parameter of an effect of the catalogue")
    return Parameter(name, prior.unit, f"{effect.title.lower()}: {own.replace('_', ' ')}")


def effect_named(word: str) -> Effect:
    """Effect of an id, of the catalogue or a curve; `ModelError` with those that there are where there is none."""
    known = catalogue()
    if word in known:
        return known[word]
    curve = curve_named(word)
    if curve is None:
        raise ModelError(f"'{word}' is not an effect; known are {', '.join(known)}{did_you_mean(word, known)}")
    return curve.effect()


def effects_named(words: Sequence[str]) -> tuple[Effect, ...]:
    """Effects by their ids, in the order of the catalogue; errors as for `effect_named`."""
    order = list(catalogue())
    if twice := next((word for i, word in enumerate(words) if word in words[:i]), None):
        raise ModelError(f"the effect '{twice}' stands twice; name each effect once")
    found = {word: effect_named(word) for word in words}
    return tuple(found[w] for w in sorted(found, key=lambda w: order.index(w) if w in order else len(order)))
