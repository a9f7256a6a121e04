"""Smooth functions of one coordinate as effects: what is found before anybody knows a formula for it.

A curve is a Gaussian process over the share of a coordinate's range, with a squared-exponential kernel, pinned to 0
where the base law holds as it is (Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, chapters 2 and
4). It is written in its principal components on a grid (Karhunen-Loeve), so it is linear in a few coefficients with
standard normal priors, and is an `Effect` like any other. A curve that comes again every so many millimetres or seconds
is one over the share of its period; its components are then the sine waves of the period and its parts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.coordinates import Coordinate, coordinate_named, coordinates
from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import felt
from shj_bayes.model.history import PREFIX, History
from shj_bayes.model.priors import Prior

ACTIONS = ("capacity", "added")
SIZES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)  # of Fy: standard deviations that a curve may have before the test
KEPT = 1e-4  # of the variance: smaller components are left out
RECALLED_NUMBERS = 2_000_000  # components at the points of a longer history are worked out anew each time
PERIODS_PER_UNIT = 1000  # to which a period is rounded, so that a word can hold it
# What is measured beside the force is no riddle: it is said with the change over its range, which the tests know.
FOLLOWS = "{what} follows {title}: it changes by {{change:+.1%}} of Fy from {{low:.4g}} to {{high:.4g}}{{unit}}."


@lru_cache(maxsize=256)
def components(length: float, zero: float) -> CubicSpline:
    """Principal components, shape (r,) at each place, of a pinned Gaussian process on 0 to 1, times their sds.

    `length` is the correlation length, `zero` where the process is 0.
    """
    n = int(np.clip(np.ceil(4.0 / length), 16, 96)) + 1
    at = np.linspace(0.0, 1.0, n)
    whole = np.append(at, zero)
    k = np.exp(-0.5 * ((whole[:, None] - whole[None, :]) / length) ** 2)
    pinned = k[:n, :n] - k[:n, n:] - k[n:, :n] + k[n, n]
    values, vectors = np.linalg.eigh(pinned)
    order = np.argsort(-values)
    kept = order[values[order] > KEPT * values.sum()]
    # A sign that does not hang on the library.
    sign = np.sign(vectors[np.argmax(np.abs(vectors[:, kept]), axis=0), kept])
    return CubicSpline(at, vectors[:, kept] * sign * np.sqrt(values[kept]))


def harmonics(length: float) -> FloatArray:
    """Give the standard deviations of the waves of a period and its parts, the whole period first; the variance is 1.

    `length` is the correlation length of the squared-exponential kernel, as a share of the period.
    """
    k = np.arange(1.0, 65.0)
    power = np.exp(-0.5 * (2.0 * np.pi * k * length) ** 2)
    power = power[power > 1e-2 * power.sum()]
    return np.asarray(np.sqrt(power / power.sum()))


IDS = re.compile(
    rf"({'|'.join(ACTIONS)})_over_({'|'.join(coordinates())})(_by_direction)?"
    r"(?:_every_([0-9]{1,9}))?_([0-9]{2})_([0-9]{2})"
)
MEASURED_IDS = re.compile(rf"({'|'.join(ACTIONS)})_over_({PREFIX}\w+)_([0-9]{{2}})_([0-9]{{2}})")


def curve_named(word: str) -> Curve | None:
    """Curve of an effect's id; None where it is no curve's."""
    if own := MEASURED_IDS.fullmatch(word):
        return Curve(own[1], own[2], int(own[3]) / 100.0, size=int(own[4]) / 100.0)
    found = IDS.fullmatch(word)
    if found is None or (found[4] and int(found[4]) == 0):
        return None
    period = int(found[4]) / PERIODS_PER_UNIT if found[4] else None
    return Curve(found[1], found[2], int(found[5]) / 100.0, found[3] is not None, int(found[6]) / 100.0, period)


@dataclass(frozen=True)
class Curve:
    """A smooth function of one coordinate that multiplies the capacity or adds a force."""

    action: str  # "capacity", "added": how it acts
    coordinate: str  # over what
    length: float  # correlation length, as a share of the range, or of the period
    sides: bool = False  # whether push and pull have curves of their own
    size: float = 0.05  # standard deviation before the test, as a share of Fy
    period: float | None = None  # after what it comes again, in the unit of the coordinate; None where it does not

    @cached_property
    def over(self) -> Coordinate:
        """The coordinate."""
        return coordinate_named(self.coordinate)

    @property
    def id(self) -> str:
        """Word of the curve as an effect."""
        own = "_by_direction" if self.sides else ""
        if self.period is not None:
            own += f"_every_{round(PERIODS_PER_UNIT * self.period)}"
        return f"{self.action}_over_{self.coordinate}{own}_{round(100 * self.length):02d}_{round(100 * self.size):02d}"

    @cached_property
    def n(self) -> int:
        """Number of coefficients."""
        if self.period is not None:
            each = 2 * harmonics(self.length).size
        else:
            each = int(components(self.length, self.over.zero_share).c.shape[-1])
        return each * (2 if self.sides else 1)

    def place(self, history: History, base: Base) -> FloatArray:
        """Where the points of a history lie, shape (n,): shares of the range, or periods since 0."""
        if self.period is not None:
            return np.asarray(self.over.values(history, base) / self.period)
        if not self.over.of_base:
            return self.over.share(history, base)
        # Most parameters of a model are those of its curves: where these lie stays as it is.
        return history.recall((self.coordinate, base), lambda: self.over.share(history, base))

    def components(self, place: FloatArray) -> FloatArray:
        """Components at given places, shape (n, r); of a curve that comes again, the waves of its period and parts."""
        if self.period is None:
            return np.asarray(components(self.length, self.over.zero_share)(place))
        sd = harmonics(self.length)
        angle = 2.0 * np.pi * place[:, None] * np.arange(1, sd.size + 1)
        return np.concatenate([sd * np.cos(angle), sd * np.sin(angle)], axis=1)

    def rows(self, place: FloatArray, direction: FloatArray) -> FloatArray:
        """Basis functions, shape (n, r): what each coefficient adds, as a share of Fy."""
        basis = self.size * self.components(place)
        return by_side(basis, direction) if self.sides else np.asarray(basis)

    def columns(self, history: History, base: Base) -> FloatArray:
        """Clamping, or force (kN), that each coefficient adds at the points of a history, shape (n, r)."""
        basis = self.size * self._components_at(history, base)
        if self.over.times is not None:
            basis = basis * self.over.times(history)[:, None]
        out = by_side(basis, history.direction) if self.sides else basis
        if self.action == "added":
            return np.asarray(base.Fy_first * out)
        if self.over.memory_mm > 0.0:
            return np.stack([felt(column, history, base, self.over.memory_mm) for column in out.T], axis=1)
        return out

    def act(self, history: History, values: Values, base: Base) -> Contribution:
        """Clamping 1 + f, or Fy_first f added to the force."""
        coefficients = self.size * np.array([values[name] for name in self.names])
        of_side = np.split(coefficients, 2) if self.sides else [coefficients]
        if self._is_passing(history) and self.period is None:  # few will ask: one curve in the place of its components
            spline, place = components(self.length, self.over.zero_share), self.place(history, base)
            curves = [PPoly.construct_fast(spline.c @ own, spline.x)(place) for own in of_side]
        else:
            basis = self._components_at(history, base)
            curves = [basis @ own for own in of_side]
        f = np.where(history.direction > 0, *curves) if self.sides else curves[0]
        if self.over.times is not None:
            f = f * self.over.times(history)
        if self.action == "capacity":
            return Contribution(clamping=1.0 + felt(f, history, base, self.over.memory_mm))
        return Contribution(added_kN=base.Fy_first * f)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(f"c{i}" for i in range(1, self.n + 1))

    def _is_passing(self, history: History) -> bool:
        """Whether the components at the points of a history are not worth keeping: few will ask, or they are many."""
        return self.over.of_base or history.passing or history.time_s.size * self.n > RECALLED_NUMBERS

    def _components_at(self, history: History, base: Base) -> FloatArray:
        """Components at the points of a history, shape (n, r)."""
        if self._is_passing(history):
            return self.components(self.place(history, base))
        key = (self.coordinate, self.period, self.length)
        return history.recall(key, lambda: self.components(self.place(history, base)))

    def effect(self) -> Effect:
        """Give the curve as an effect of the device model."""
        what = "Sliding force" if self.action == "capacity" else "A force that is added"
        again = "" if self.period is None else f" and comes again every {self.period:.3g} {self.over.unit}"
        effect = Effect(
            id=self.id,
            family=self.over.family,
            title=f"{what} over {self.over.title.removeprefix('the ')}",
            statement=f"{what} changes with {self.over.title}{again}: see the curve.",
            equation="Fy -> Fy (1 + f(u))" if self.action == "capacity" else "F -> F + Fy f(u)",
            cause="No known mechanism has this curve.",
            shows=f"Alike wherever {self.over.title} is alike.",
            next_test=f"A test in which {self.over.title} changes on its own.",
            parameters=tuple(map(coefficient, self.names)),
            neutral=dict.fromkeys(self.names, 0.0),
            act=self.act,
            columns=self.columns,
            columns_added=self.action == "added",
            source="Gaussian process in its principal components.",
        )
        if not self.over.measured:
            return effect
        return replace(
            effect,
            title=f"{what} follows {self.over.title}",
            statement=FOLLOWS.format(what=what, title=self.over.title),
            cause="Friction is a coefficient times the clamping force; what changes either changes the force.",
            mechanism=self.coordinate,
        )


@cache
def coefficient(name: str) -> Prior:
    """Prior of a coefficient."""
    return Prior(name, "1", "normal", 0.0, 1.0, "Coefficient of a principal component.")


def by_side(basis: FloatArray, direction: FloatArray) -> FloatArray:
    """Functions for push and then those for pull, shape (n, r) to (n, 2 r)."""
    push = (direction > 0)[:, None]
    return np.concatenate([np.where(push, basis, 0.0), np.where(push, 0.0, basis)], axis=1)
