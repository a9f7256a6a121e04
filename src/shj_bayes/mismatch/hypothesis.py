"""What a device may do beyond its base law, one dependence for each coordinate and way of acting; and sets of them.

A hypothesis is a set with the model that holds it: its members, their sizes, and their shapes.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.start import extended, start_values
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.laplace import Laplace, drawn_from, largest, visible
from shj_bayes.model.coordinates import coordinate_named, coordinates, coordinates_of
from shj_bayes.model.curve import SIZES, Curve
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect, catalogue
from shj_bayes.model.history import Measured
from shj_bayes.results.diagnosis import DependenceId

MIN_EFFECT = 0.01  # of Fy: a smaller effect is negligible for design
ALPHA = 0.05  # probability that is given up: verdicts hold with 95 %
EXPLAINED = 0.8  # of a curve, that a formula must follow to be its name where it is not within what matters
PRIOR_INCLUSION = 0.05  # probability of each class before the test: about one in a device
LOG_PRIOR_ODDS = math.log(PRIOR_INCLUSION / (1.0 - PRIOR_INCLUSION))
TYPICAL, SPREAD = 0.04, 1.2  # of Fy, and of its logarithm: how large a curve is where there is one
FORMS = 0.5  # probability that a dependence that may be a curve has one of the published formulas of its coordinate
FEW_STARTS = 12  # formulas with more are tried in the place of a curve only
CURVES = (
    *dict.fromkeys(("capacity", one.group or one.id) for one in coordinates().values() if one.times is None),
    *(("added", name) for name, one in coordinates().items() if one.adds),
)
CONSTANT = str(DependenceId("added", "constant"))
TEETH = DependenceId("motion", "stick-slip")
POSITION, DISTANCE, DIRECTION, SLIP, TRAVEL, TIME = (
    str(DependenceId("capacity", name)) for name in ("position", "distance", "direction", "slip", "travel", "time")
)


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """One way to write a class: a curve of some smoothness, or an effect of the catalogue."""

    curve: Curve | None  # the curve
    effect: Effect  # the same as an effect, or the effect of the catalogue
    weight: float  # probability of the variant within its class


@dataclass(frozen=True, eq=False)
class Dependence:
    """A dependence of the force on one coordinate."""

    action: str  # how it acts
    coordinate: str  # on what it depends
    unit: str  # unit of the coordinate
    variants: tuple[Parametrisation, ...]  # ways to write it

    @property
    def id(self) -> str:
        """Short word."""
        return str(DependenceId(self.action, self.coordinate))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A class that could be added to a model, to first order."""

    of: Dependence  # the class
    variant: Parametrisation  # how it is written
    start: FloatArray  # shape (n_law,): parameters of the larger model to start from
    columns: FloatArray  # shape (n, p): what it could add to the force, kN, by unit of each of its coefficients
    model: DeviceModel  # the larger model
    gain: float = 0.0  # log Bayes factor over the smaller model to first order, with the weight of the variant; nats
    # shape (n,): what it is expected to add to the force, kN, to first order
    change: FloatArray = field(default_factory=lambda: np.zeros(0))


def classes(
    hidden: frozenset[str] = frozenset(), measured: Mapping[str, Measured] = MappingProxyType({})
) -> tuple[Dependence, ...]:
    """All classes; a curve is left out when all effects of its class are `hidden`.

    `measured` holds further channels of the recordings by coordinate: clamping may follow each.
    """
    out = []
    for key in dict.fromkeys(key for effect in catalogue().values() for key in effect.acts):
        action, name = key
        written = formulas(key, hidden)
        shown = [one for one in written if not one.effect.form]
        if not shown:
            continue
        if key not in CURVES:
            out.append(Dependence(action, name, "1", tuple(shown)))
            continue
        over = coordinates_of(name)
        smooth = (1.0 - FORMS) * (1.0 - over[0].repeats)
        sides = over[0].sides if action == "capacity" else 0.0
        variants = [
            Parametrisation(
                curve := Curve(action, u.id, length, own), curve.effect(), smooth * weight * share / len(over)
            )
            for u in over
            for length, weight in u.lengths.items()
            for own, share in ((False, 1.0 - sides), (True, sides))
            if share
        ]
        few = [one for one in shown if math.prod(map(len, start_values(one.effect))) <= FEW_STARTS]
        out.append(Dependence(action, name, over[0].unit, (*variants, *few)))
    both = {name: one.unit for name, one in coordinates().items() if one.times is not None}
    rest = [_without_formula(name, unit, PRIOR_INCLUSION * (1.0 - FORMS)) for name, unit in both.items()]
    return (*out, *rest, *(_without_formula(name, one.unit) for name, one in measured.items() if name not in hidden))


def formulas(key: tuple[str, str], hidden: frozenset[str] = frozenset()) -> list[Parametrisation]:
    """Give the formulas of a class, by action and coordinate, each as probable before the test as the others.

    Together they have what a curve leaves them, or all where there is none: more of them make no class more probable.
    """
    known = [effect for effect in catalogue().values() if key in effect.acts and effect.mechanism not in hidden]
    share = FORMS if key in CURVES else 1.0
    return [Parametrisation(None, effect, share / len(known)) for effect in known]


def _without_formula(name: str, unit: str, weight: float = 1.0) -> Dependence:
    """Class of a sliding force over a coordinate for which no formula beyond its curve is known.

    What needs two coordinates at once has the probabilities of both, and of a class without a formula (`weight`).
    """
    curves = [(Curve("capacity", name, length), share) for length, share in coordinate_named(name).lengths.items()]
    variants = tuple(Parametrisation(curve, curve.effect(), weight * share) for curve, share in curves)
    return Dependence("capacity", name, unit, variants)


def candidates(data: BinnedData, state: Laplace, of: tuple[Dependence, ...]) -> list[Candidate]:
    """Everything that could be added to a model, one at a time, with the columns of the first order."""
    out = []
    for one in of:
        for variant in one.variants:
            model = state.model.with_effects((*state.model.effects, variant.effect))
            if variant.curve is not None:
                n, step = len(variant.effect.parameters), 1e-2
                zero = np.concatenate([state.z, np.zeros(n)])
                points = zero + step * np.eye(n, zero.size, state.z.size)
                columns = (state.residual - data.likelihood.at(model).residual(points)).T / step
                out.append(Candidate(one, variant, zero, columns, model))
                continue
            starts = np.array(extended(state.z, state.model, model, variant.effect))
            changes = (state.residual - data.likelihood.at(model).residual(starts)).T
            finite = np.all(np.isfinite(changes), axis=0) & np.any(changes != 0.0, axis=0)
            out += [Candidate(one, variant, starts[i], changes[:, i : i + 1], model) for i in np.flatnonzero(finite)]
    return out


def unit_columns(c: Candidate) -> FloatArray:
    """Columns of a candidate of the size that fits best, for coefficients with standard normal priors."""
    curve = c.variant.curve  # its columns are of the size with which every class states its curves
    return c.columns if curve is None else np.asarray(c.columns * (curve.size / Curve.size))


def sized(curve: Curve, size: float) -> Curve:
    """Give the same curve the standard deviation of `SIZES` that is nearest to a size, as a share of Fy."""
    nearest = min(SIZES, key=lambda one: abs(np.log(one / size)))
    return replace(curve, size=nearest)


def size_weights() -> FloatArray:
    """Probability of each of `curve.SIZES` before the test."""
    weights = np.exp(-0.5 * (np.log(np.array(SIZES) / TYPICAL) / SPREAD) ** 2)
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of classes with the model that holds them."""

    members: tuple[Candidate, ...]  # classes, in the order of the effects of the model behind those that were given
    state: Laplace  # the model, fitted
    log_weight: float  # log of the evidence times the probability before the test
    metric: ErrorModel | None = None  # noise and discrepancy under which it was weighed; None during a search

    @property
    def key(self) -> frozenset[str]:
        """Ids of the classes."""
        return frozenset(member.of.id for member in self.members)


def columns_of(data: BinnedData, state: Laplace, place: int) -> list[int]:
    """Positions of the parameters of a member, in the place among its classes, in the vector of a model."""
    effect = state.model.effects[len(data.device.effects) + place]
    return [i for i, name in enumerate(state.model.law_names) if name.startswith(f"{effect.id}.")]


def without(data: BinnedData, h: Hypothesis, place: int) -> tuple[tuple[Candidate, ...], FloatArray]:
    """Members of a hypothesis less the one in a place, and where the rest of its model is."""
    members = (*h.members[:place], *h.members[place + 1 :])
    return members, np.delete(h.state.z, columns_of(data, h.state, place))


def joined(h: Hypothesis, c: Candidate) -> FloatArray:
    """Start of a hypothesis with one more class: the parameters of the smaller one, and where the class begins."""
    return np.concatenate([h.state.z, c.start[-len(c.variant.effect.parameters) :]])


def replaced(h: Hypothesis, place: int, member: Candidate) -> tuple[Candidate, ...]:
    """Give the members of a hypothesis with another one in a place."""
    return (*h.members[:place], member, *h.members[place + 1 :])


def is_curve(member: Candidate) -> bool:
    """Whether a class has no formula here: it is a curve, or it acts on the motion."""
    return member.variant.curve is not None or not any(v.curve is not None for v in member.of.variants)


def second_of(member: Candidate) -> str | None:
    """Class that a curve may hold beside its own: position and distance, or time and direction where both count."""
    curve = member.variant.curve
    if curve is not None and curve.sides:
        return DIRECTION
    return DISTANCE if curve is not None and member.of.id == POSITION else None


def same_twice(a: Candidate, b: Candidate) -> bool:
    """Whether one of two is a curve over position and the other a function of the distance, its even part."""
    pairs = [(m, n) for m, n in ((a, b), (b, a)) if (m.of.id, n.of.id) == (POSITION, DISTANCE)]
    return any(m.variant.curve is not None for m, _ in pairs)


def cancel(state: Laplace, members: tuple[Candidate, ...]) -> bool:
    """Whether a constant force and a difference of push and pull leave less than half of the smaller one together."""
    a, b = (
        sum(state.values_of(m.variant.effect)["size"] for m in members if m.of.id == of) for of in (CONSTANT, DIRECTION)
    )
    return a * b < 0.0 and abs(a + b) < 0.5 * min(abs(a), abs(b))


MOTION = "motion"
N_SIZES = 60  # draws from which the upper limit of a size is taken
STEP = 1e-3  # of a parameter in its unbounded space, for derivatives of the force of a member


def size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Size of a member at the most probable parameters, as a share of Fy.

    The 99th percentile of its force that the base law could not make, by `visible`; of a constant, all of it.
    """
    return float(_sizes(data, h, place, h.state.z[None])[0])


def largest_size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Upper limit of the size of a member, exceeded with a probability of `ALPHA`, a share of Fy."""
    return float(np.quantile(_sizes(data, h, place, drawn_from(h.state, N_SIZES)), 1.0 - ALPHA))


def _sizes(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Size of a member for each of some parameter sets of its model, shape (m, n_law) to (m,), to first order.

    Farther from the most probable parameters a formula has forces that the recording refuses, but no Gaussian around
    them does. What acts on the motion makes its force between the bends of the base law, where the blocks of a search
    are long. A constant is as large as it is: the law makes none, also where it begins loaded by it.
    """
    if h.members[place].of.action == MOTION:
        data = data.finer_at(h.state.model, h.state.z)
    away = z - h.state.z
    moves = np.flatnonzero(np.any(away != 0.0, axis=0))
    forces = force_of(data, h, place, h.state.z + STEP * np.vstack([np.zeros(z.shape[1]), np.eye(z.shape[1])[moves]]))
    forces = forces[0] + away[:, moves] @ ((forces[1:] - forces[0]) / STEP)
    if h.members[place].of.id == CONSTANT:
        return np.asarray(np.abs(forces[:, data.blocks.used > 0]).max(axis=1) / data.scale_kN)
    return visible(data, _law_slopes(h, data), forces.T)


def force_of(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Force of a member for each of some parameter sets of its model, shape (m, n_law) to (m, n), kN."""
    model, effect = h.state.model, h.members[place].variant.effect
    rest = tuple(e for e in model.effects if e.id != effect.id)
    others = np.delete(z, columns_of(data, h.state, place), axis=1)
    without = data.likelihood.at(model.with_effects(rest))
    return without.residual(others) - data.likelihood.at(model).residual(z)


def _law_slopes(h: Hypothesis, data: BinnedData) -> FloatArray:
    """Give the derivatives of the law by itself, shape (n, n_law), kN.

    Beside a constant of many times Fy, a change of Fy is a change of the constant.
    """
    law = h.state.of_law(data.device)
    return data.likelihood.jacobian(law, data.likelihood.residual(law[None])[0])


def tolerance(data: BinnedData, h: Hypothesis, place: int) -> float:
    """How far a formula may be from a curve that it is the name of, a share of Fy.

    At most half of the curve: a formula that leaves more than it explains says nothing.
    """
    size = size_of(data, h, place)
    return min(max(MIN_EFFECT, (1.0 - EXPLAINED) * size), 0.5 * size)


def force_distance(data: BinnedData, a: Hypothesis, b: Hypothesis) -> float:
    """How far the forces of two hypotheses are apart (99th percentile over the samples), as a share of Fy."""
    used = data.blocks.used > 0
    apart = (b.state.residual - a.state.residual)[used, None]
    return float(largest(apart, data.blocks.n_samples[used])[0]) / data.scale_kN


@dataclass(frozen=True)
class Shape:
    """A curve over a share u of a range: linear in its sizes, with one length or place that is not."""

    name: str  # short word
    # ``columns(u, length)``, shape (n, n_sizes); the last size is a constant
    columns: Callable[[FloatArray, float], FloatArray]
    lengths: FloatArray  # lengths or places to try, as shares of the range
    # ``text(sizes, length, name, unit)`` writes the formula; lengths are in the unit
    text: Callable[[FloatArray, float, str, str], str]


def _with_one(*columns: FloatArray) -> FloatArray:
    return np.stack([*columns, np.ones_like(columns[0])], axis=1)


def _wave(sizes: FloatArray, length: float, x: str, unit: str) -> str:
    size, phase = float(np.hypot(sizes[0], sizes[1])), float(np.arctan2(sizes[1], sizes[0]))
    return f"{size:.3g} sin(2 pi {x} / {length:.3g} {unit} {phase:+.2g}) {sizes[2]:+.3g}"


SHAPES = (
    Shape("line", lambda u, _: _with_one(u), np.ones(1), lambda s, _, x, unit: f"{s[0]:.3g} {x}/range {s[1]:+.3g}"),
    Shape(
        "parabola", lambda u, _: _with_one(u**2, u), np.ones(1),
        lambda s, _, x, unit: f"{s[0]:.3g} ({x}/range)^2 {s[1]:+.3g} {x}/range {s[2]:+.3g}",
    ),
    Shape(
        "modulus", lambda u, c: _with_one(np.abs(u - c)), np.linspace(0.05, 0.95, 91),
        lambda s, c, x, unit: f"{s[0]:.3g} |{x} - {c:.3g} {unit}|/range {s[1]:+.3g}",
    ),
    Shape(
        "step", lambda u, c: _with_one(1.0 / (1.0 + np.exp(-np.clip((u - c) / 0.01, -50, 50)))),
        np.linspace(0.05, 0.95, 91), lambda s, c, x, unit: f"{s[0]:.3g} step({x} - {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape(
        "exponential", lambda u, c: _with_one(np.exp(-u / c)), np.geomspace(1 / 60, 2.0, 40),
        lambda s, c, x, unit: f"{s[0]:.3g} exp(-{x} / {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape("sine", lambda u, c: _with_one(np.sin(2 * np.pi * u / c), np.cos(2 * np.pi * u / c)),
          1.0 / np.arange(1.0, 16.0, 0.1), _wave),
)  # fmt: skip


def formula_of(at: FloatArray, mean: FloatArray, low: FloatArray, high: FloatArray, name: str, unit: str) -> str | None:
    """Simplest formula that lies within the band of a curve, per cent of Fy, or misses it by less than what matters.

    Its right-hand side, with symbol and unit of the coordinate; None where no shape of a few numbers does.
    """
    first, span = float(at[0]), float(np.ptp(at))
    u = (at - first) / span
    weight = 1.0 / np.maximum(high - low, 0.2 * 100 * MIN_EFFECT)
    allowed = np.maximum(0.5 * (high - low), 100 * MIN_EFFECT)
    for shape in SHAPES:
        best: tuple[float, FloatArray, float] | None = None
        for length in shape.lengths:
            columns = shape.columns(u, float(length))
            solved = np.linalg.lstsq(columns * weight[:, None], mean * weight, rcond=1e-9)[0]
            sizes = np.asarray(solved, dtype=np.float64)
            worst = float(np.max(np.abs(columns @ sizes - mean) / allowed))
            if best is None or worst < best[0]:
                best = (worst, sizes, float(length))
        assert best is not None
        if best[0] <= 1.0:
            place = best[2] * span + (first if shape.name in ("modulus", "step") else 0.0)
            symbol = name if first == 0.0 or shape.name in ("modulus", "step") else f"({name} - {first:.3g} {unit})"
            return shape.text(best[1], place, symbol, unit)
    return None
