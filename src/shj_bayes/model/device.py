"""The model of one device: the published law, effects that are added to it and the noise, as one parameter vector."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model.augmented import force_with_effects, slopes_with_effects
from shj_bayes.model.curve import curve_named
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.effects.effect import Base, Contribution, Effect
from shj_bayes.model.history import History
from shj_bayes.model.law import force_of_laws, variant_named
from shj_bayes.model.noise.catalogue import DEFAULT, noise_model
from shj_bayes.model.noise.noise import Noise
from shj_bayes.model.parameters import SHAREABLE, FloatArray, Parameter, describe, run_name
from shj_bayes.model.priors import Prior, Priors


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
    def laws_of_parameters(self) -> tuple[Prior, ...]:
        """Prior of each sampled parameter."""
        own = {f"{effect.id}.{prior.name}": prior for effect in self.effects for prior in effect.parameters}
        return tuple(own[name] if name in own else self.priors.of(name) for name in self.names)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sampled parameters with unit and meaning."""
        return tuple(meaning_of(name) for name in self.names)

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
        pairs = zip(self.law_names, self.laws_of_parameters, z, strict=False)
        return {name: float(prior.from_free(np.asarray(value))) for name, prior, value in pairs}

    @cached_property
    def predicted(self) -> NDArray[np.bool_]:
        """For each parameter, whether other cycles tell of it: not of the state in which a test began, shape (d,)."""
        initial = {f"{effect.id}.{name}" for effect in self.effects for name in effect.initial}
        return np.array([name not in initial for name in self.names])

    def with_effects(self, effects: Sequence[Effect]) -> DeviceModel:
        """Give the same device with other effects."""
        return replace(self, effects=tuple(effects))

    def index(self, name: str) -> int:
        """Position of a parameter in a vector."""
        return self.names.index(name)

    def natural(self, z: FloatArray) -> FloatArray:
        """Unbounded vectors, shape (..., d), to parameters in natural units, shape (..., d)."""
        mean, sd, others = self._normal
        out = mean + sd * z
        for i in others:
            out[..., i] = self.laws_of_parameters[i].from_free(z[..., i])
        return np.asarray(out)

    @cached_property
    def _normal(self) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
        """Mean and standard deviation of the normal priors, and the places of the others: curves have many of these."""
        laws = self.laws_of_parameters
        others = tuple(i for i, law in enumerate(laws) if law.law != "normal")
        normal = np.array([(law.a, law.b) if law.law == "normal" else (0.0, 0.0) for law in laws])
        return normal[:, 0], normal[:, 1], others

    def natural_of_law(self, z: FloatArray) -> FloatArray:
        """Unbounded vectors of the law alone, shape (m, n_law), to all, shape (m, d), noise at its median."""
        return self.natural(np.pad(z, ((0, 0), (0, len(self.names) - z.shape[1]))))

    def unbounded(self, theta: FloatArray) -> FloatArray:
        """Parameters in natural units, shape (m, d), to unbounded vectors."""
        return np.stack([prior.to_free(theta[:, i]) for i, prior in enumerate(self.laws_of_parameters)], axis=1)

    def log_prior(self, z: FloatArray) -> FloatArray:
        """Log prior density in the unbounded space, shape (m, d) to (m,)."""
        terms = [prior.log_density_free(z[:, i]) for i, prior in enumerate(self.laws_of_parameters)]
        return np.asarray(np.sum(terms, axis=0))

    def run_laws(self, theta: FloatArray, run: int) -> FloatArray:
        """K (kN/mm), Fy of that run (kN), beta and gamma (s/mm) of parameter sets, shape (m, d) to (m, 4)."""
        at = {
            name: self.index(f"{name}_{run}" if run > 1 and name in self.free else name)
            for name in SHAREABLE
            if self.speed or name != "gamma"
        }
        gamma = theta[:, at["gamma"]] if self.speed else np.zeros(theta.shape[0])
        capacity = theta[:, self.index("Fy")]
        if run > 1:
            capacity = capacity * theta[:, self.index(run_name("ratio", run))]
        return np.ascontiguousarray(np.stack([theta[:, at["K"]], capacity, theta[:, at["beta"]], gamma], axis=1))

    def acting(self, theta: FloatArray, run: int) -> Iterator[tuple[Base, list[tuple[Effect, dict[str, float]]]]]:
        """Law of a run and the effects with their values, for each of some parameter sets, shape (m, d)."""
        laws, first = self.run_laws(theta, run).tolist(), self.index("Fy")
        places = [(e, [(p.name, self.index(f"{e.id}.{p.name}")) for p in e.parameters]) for e in self.effects]
        for own, (stiffness, capacity, beta, gamma) in zip(theta.tolist(), laws, strict=True):
            base = Base(stiffness, capacity, beta, gamma, own[first])
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

    @cached_property
    def linear(self) -> NDArray[np.intp]:
        """Places of the parameters that belong to effects which are linear in theirs, shape (p,): those of `slopes`."""
        of = {f"{e.id}.{name}" for e in self.effects if e.columns for name in e.names}
        return np.flatnonzero([name in of for name in self.names])

    def slopes(self, theta: FloatArray, history: History, start_force_kN: float) -> FloatArray:
        """Give the derivatives of the force of one run after the parameters at `linear`, shape (d,) to (n_samples, p).

        In the unbounded space, kN; other arguments as for `force`.
        """
        ((base, acting),) = self.acting(theta[None], history.run)
        own = slopes_with_effects(history, base, acting, variant=self.variant, start_force_kN=start_force_kN)
        return own * self._normal[1][self.linear]

    def noise_values(self, theta: FloatArray) -> dict[str, FloatArray]:
        """Noise parameters by name, each of shape (m,)."""
        return {name: np.ascontiguousarray(theta[:, self.index(name)]) for name in self.noise.parameters}


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
